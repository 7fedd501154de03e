"""Coverage of identified parameters: estimates and standard errors beside the truth of the rigs.

    python -m bench.identified_parameters --rigs default drive --draws 20 --out build/coverage

Each draw varies the rig's stiffness, mass and damping as the benchmark of the gap workflow does
(`models.rig.drawn_rig.LINK_DEVIATION`), runs payloads of 0, 1 and 2 kg with one joint and
identifies the plant. Parameters that rig and plant both have are compared. One file per draw in
OUT; a rerun does what is missing or of other code, prints all and writes OUT/coverage.json.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.console import Progress
from firmware_py.motion import Motion
from hil.campaign.code_version import code_version
from models.plant.identification.identification import identify
from models.plant.parameter import bound_reached
from models.plant.plant import read_plant
from models.rig.drawn_rig import LINK_DEVIATION, rig_named
from models.rig.rig_parameters import RigParameters
from models.rig.study_protocol import run_case
from models.rig.trial_case import TrialCase
from models.trials.trial import TrialSet

PAYLOADS_KG: Final = (0.0, 1.0, 2.0)

COMPUTING_ROOMS: Final = ("firmware_py", "models")
"""Rooms of which a change makes a draw's result invalid."""

SAME_AS_IN_RIG: Final = {
    "coulomb_friction_1_nm": "servo.coulomb_friction_nm",
    "viscous_friction_1_nm_s_rad": "servo.viscous_friction_nm_s_rad",
    "load_dependent_friction_1": "servo.load_friction_share",
    "position_gain_1_per_s": "servo.position_gain_per_s",
    "rotor_inertia_1_kg_m2": "servo.inertia_kg_m2",
    "link_mass_kg": "link.mass_kg",
    "tip_mass_kg": "link.tip_mass_kg",
    "prebend_1_rad": "stiffness.prebend_rad",
    "directional_stiffness_1": "stiffness.directional_share",
    "creep_share_1": "memory.relaxing_share",
    "goal_delay_1_s": "servo.dead_time_s",
}
"""Parameters of the plant that are parameters of the rig."""

RELATIVE: Final = ("viscous_friction_1_nm_s_rad", "link_mass_kg")
"""Parameters that are to be right within a quarter whatever their standard errors."""

FEEDFORWARD: Final = "velocity_feedforward_1"
"""Option of a servo that `identify` keeps where the trials speak for it."""

INTERPOLATION: Final = {"held": 0.0, "interpolated": 1.0}
"""Shape of the goal; a profile has no counterpart."""


def shared_truth(p: RigParameters) -> dict[str, float]:
    """True values of the plant's parameters in a rig."""
    truth = {own: p[name] for own, name in SAME_AS_IN_RIG.items()}
    bandwidth, constant = p["servo.velocity_bandwidth_rad_s"], p["servo.torque_constant_nm_a"]
    truth["velocity_gain_1_a_s_rad"] = bandwidth * p["servo.inertia_kg_m2"] / constant
    truth["velocity_integral_time_1_s"] = 1.0 / p["servo.velocity_integral_rad_s"]
    extended = p.structure.position_loop == "feedforward"
    truth[FEEDFORWARD] = p["servo.velocity_feedforward"] if extended else 0.0
    integral = p["servo.position_integral_per_s2"] if extended else 0.0
    truth["position_integral_1_per_s2"] = integral
    if p.structure.goal in INTERPOLATION:
        truth["goal_interpolation_1"] = INTERPOLATION[p.structure.goal]
    else:
        del truth["goal_delay_1_s"]  # a profile is late by itself
    return truth


def identify_draw(rig: str, draw: int) -> dict[str, Any]:
    """Identify the plant on one draw of a rig.

    Returns parameters with value, error, truth and bound; errors of the fitted trials.
    """
    rng = np.random.default_rng([20, draw])
    own = rig_named(rig)
    factors = {n: float(np.exp(s * rng.standard_normal())) for n, s in LINK_DEVIATION.items()}
    parameters = own.changed(**{n: own[n] * factor for n, factor in factors.items()})
    seed = int(rng.integers(2**31))
    trials = TrialSet(
        tuple(run_case(parameters, TrialCase(Motion(), m, 1, seed)) for m in PAYLOADS_KG)
    )
    found, truth = identify(read_plant(), trials), shared_truth(parameters)
    return {
        "rig": rig, "draw": draw, "tip_rms_m": found.held_out.tip_rms_m,
        "feedforward": truth[FEEDFORWARD],
        "feedforward_found": found.plant.parameters[FEEDFORWARD].role != "fixed",
        "parameters": {
            q.name: {
                "value": q.value, "error": q.error, "truth": truth[q.name],
                "bound": bound_reached(q),
            }
            for q in found.fitted if q.name in truth
        },
    }  # fmt: skip


def coverage_table(results: Iterable[Mapping[str, Any]]) -> str:
    """Text of one row per rig and parameter: covered draws, median ratio, errors, bounds."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for result in results:
        for name, row in result["parameters"].items():
            groups[result["rig"], name].append(row)
    lines = [
        f"{'rig':10s}{'parameter':30s}{'covered':>9s}{'truth':>9s}{'median':>9s}{'error':>9s}"
        f"{'within 25 %':>13s}{'at a bound':>12s}"
    ]
    total: dict[str, list[bool]] = defaultdict(list)
    for (rig, name), rows in groups.items():
        covered = [abs(r["value"] - r["truth"]) <= 2 * r["error"] for r in rows]
        near = [abs(r["value"] - r["truth"]) <= 0.25 * abs(r["truth"]) for r in rows]
        bound = sum(r["bound"] is not None for r in rows)
        total[rig] += covered
        middle = [float(np.median([r[key] for r in rows])) for key in ("truth", "value", "error")]
        lines.append(
            f"{rig:10s}{name:30s}{sum(covered):>6d}/{len(rows)}"
            + "".join(f"{value:9.3g}" for value in middle)
            + f"{sum(near):>11d}/{len(rows)}{bound:>12d}"
        )
    lines += [f"{rig}: {np.mean(c):.0%} of {len(c)} inside two errors" for rig, c in total.items()]
    return "\n".join(lines)


def coverage_summary(results: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Fractions and relative errors of each rig, and of all (`all`)."""
    groups: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for result in results:
        groups[result["rig"]].append(result["parameters"])
        groups["all"].append(result["parameters"])
    summary = {}
    for rig in sorted(groups, key=lambda name: name == "all"):  # the sum comes last
        draws = groups[rig]
        rows = [row for draw in draws for row in draw.values()]
        inside = [abs(r["value"] - r["truth"]) <= 2 * r["error"] for r in rows]
        own = {"draws": float(len(draws)), "inside": float(np.mean(inside))}
        for name in RELATIVE:
            found = [draw[name] for draw in draws if name in draw]
            off = np.array([abs(r["value"] / r["truth"] - 1) for r in found])
            if len(off):
                own |= {
                    f"{name} median": float(np.median(off)),
                    f"{name} 90 %": float(np.quantile(off, 0.9)),
                    f"{name} worst": float(np.max(off)),
                    f"{name} within 25 %": float(np.mean(off <= 0.25)),
                }
        summary[rig] = own
    return summary


def option_summary(results: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """How often feed-forward was found where servos have it, and where they do not.

    Returns draws, and the fractions `found` and `invented`; where a servo has it, also the largest
    error of the position gain relative to it and of the feed-forward.
    """
    rows = list(results)
    own = [r for r in rows if r["feedforward"]]
    bare = [r for r in rows if not r["feedforward"]]
    found = [r for r in own if r["feedforward_found"]]
    summary = {"with": float(len(own)), "without": float(len(bare))}
    if bare:
        summary["invented"] = float(np.mean([r["feedforward_found"] for r in bare]))
    if own:
        gains = [r["parameters"]["position_gain_1_per_s"] for r in own]
        errors = [r["parameters"][FEEDFORWARD]["value"] - r["feedforward"] for r in found]
        summary |= {
            "found": len(found) / len(own),
            "position gain worst": max(abs(q["value"] / q["truth"] - 1) for q in gains),
            "feedforward worst": max(map(abs, errors), default=float("nan")),
        }
    return summary


def summary_table(summary: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown table of a summary."""
    lines = [
        "| rig | draws | inside two errors | "
        + " | ".join(f"{name}: median, 90 %, worst | within 25 %" for name in RELATIVE) + " |",
        "|---|" + "---|" * (2 + 2 * len(RELATIVE)),
    ]  # fmt: skip
    for rig, own in summary.items():
        cells = [rig, f"{own['draws']:.0f}", f"{own['inside']:.0%}"]
        for name in RELATIVE:
            if f"{name} median" in own:
                off = (f"{own[f'{name} {what}']:.0%}" for what in ("median", "90 %", "worst"))
                cells += [", ".join(off), f"{own[f'{name} within 25 %']:.0%}"]
            else:
                cells += ["–", "–"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw_result(out: Path, rig: str, draw: int) -> dict[str, Any]:
    """Result of a draw: the file in a directory, or where it is missing or of other code a new
    one.
    """
    path, code = out / f"{rig}_{draw}.json", code_version(COMPUTING_ROOMS)
    result: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    if result.get("code") != code:
        result = {"code": code, **identify_draw(rig, draw)}
        path.write_text(json.dumps(result, indent=1))
    return result


def main(argv: list[str] | None = None) -> int:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.identified_parameters", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--rigs", nargs="+", default=["default"], help="names of structures")
    parser.add_argument("--draws", type=int, default=4, help="draws of each rig")
    parser.add_argument("--out", type=Path, required=True, help="directory of the results")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    wanted = [(draw, rig) for draw in range(args.draws) for rig in args.rigs]
    progress = Progress("bench.identified_parameters", len(wanted))
    results = []
    for draw, rig in wanted:
        results.append(draw_result(args.out, rig, draw))
        progress.step(f"{rig}_{draw}")
    summary, options = coverage_summary(results), option_summary(results)
    (args.out / "coverage.json").write_text(json.dumps(summary | {"options": options}, indent=1))
    print(coverage_table(results))
    print(summary_table(summary))
    print(", ".join(f"{what} {value:.3g}" for what, value in options.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
