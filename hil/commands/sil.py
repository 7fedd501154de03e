"""Run the robot's loop against emulated servos with a plant behind them, and judge its timing.

Writes to OUT: timing.json and timing.xml (the verdict), *.hgrm (percentiles in HdrHistogram's
format), timeline.json (for ui.perfetto.dev), ticks.mcap (the robot's own log), trial/sil.csv
(the run as a trial, with the true tip), summary.svg. Exit 0 pass, 1 deadlines missed by our own
doing, or stopped by the safety supervisor, 3 inconclusive: the host kept the processor.

With --rig the virtual laboratory stands behind the servos instead of a twin, on the virtual line:
the robot's prediction then meets a reality that no plant of ours describes.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any, get_args

from firmware_py.bus.servo_models import model_named
from firmware_py.config import MotionConfig
from firmware_py.console import emit
from firmware_py.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.motion import KINDS, STUDY_PERIOD_S
from firmware_py.summary import Ended
from hil import sil, sil_artifacts
from hil.arguments import add_line_arguments
from hil.emulator.line_faults import parse_rates
from hil.emulator.physics import RigSource
from hil.timing import tick_budget, timing_verdict
from hil.timing.hdr_histogram import write_hgrm
from hil.timing.timeline import write_timeline
from models.shared.catalogue import parse_strengths
from models.trials.trial_files import write_trial

EXAMPLE = (
    "python -m hil sil --bundle build/bundle_1dof --fmu build/twin_1dof.fmu --out build/sil "
    "--seconds 60 --load 1"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--bundle", type=Path, required=True, help="what the robot runs")
    parser.add_argument("--out", type=Path, required=True, help="directory for the results")
    parser.add_argument(
        "--fmu", type=Path, help="twin behind the servos (default: built from the bundle's plant)"
    )
    parser.add_argument(
        "--rig", action="store_true", help="put the virtual laboratory behind the servos instead"
    )
    parser.add_argument(
        "--hide", action="append", default=[], metavar="EFFECT=STRENGTH",
        help="with --rig: add an effect to what the laboratory has; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--line", choices=get_args(sil.LineKind), default="socket",
        help="socket for timing claims, pty as with any program, virtual clock (default: socket)",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=10.0, help="duration (default: 10)")
    parser.add_argument("--motion", choices=KINDS, default="sinusoid")
    parser.add_argument("--amplitude-deg", type=float, default=30.0)
    parser.add_argument("--period", type=float, default=STUDY_PERIOD_S, help="of a cycle, s")
    parser.add_argument("--phase-deg", type=float, default=0.0, help="of joint 2")
    parser.add_argument(
        "--load", type=int, default=0, metavar="N",
        help="processes that load the other processor; declared host load",
    )  # fmt: skip
    add_line_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run, judge, write."""
    options = sil.SilOptions(
        bundle=ModelBundle.load(args.bundle),
        model=model_named(args.model),
        out=args.out,
        fmu=args.fmu,
        rig=_rig_source(args),
        line=args.line,
        seconds=args.seconds,
        baud=args.baud,
        latency_s=args.latency_ms * 1e-3,
        payload_kg=args.payload_kg,
        motion=MotionConfig(
            kind=args.motion,
            amplitude_rad=math.radians(args.amplitude_deg),
            period_s=args.period,
            phase_2_rad=math.radians(args.phase_deg),
        ),
        load=args.load,
        faults=parse_rates(args.faults),
        seed=args.seed,
    )
    result = sil.run_sil(options)
    timing = write_results(result, options)
    emit(args, timing, describe_sil(timing, args.out))
    return timing_verdict.exit_code(timing)


def _rig_source(args: argparse.Namespace) -> RigSource | None:
    hidden = parse_strengths(args.hide)
    if hidden and not args.rig:
        raise InputError("--hide", "needs the laboratory, not a twin", "add --rig")
    return RigSource(hidden, args.seed) if args.rig else None


def write_results(result: sil.SilResult, options: sil.SilOptions) -> dict[str, Any]:
    """Judge a run and write everything but the log, which the recorder wrote; return timing."""
    summary, out = result.summary, options.out
    timing = timing_verdict.judge_timing(
        result.records, options.period_s, result.loop_cpu, result.line_cpu,
        result.outcome.releases, result.environment,
        summary.reason if summary.ended is Ended.TRIPPED else "",
    )  # fmt: skip
    timing["run"] = {
        "ended": summary.ended.value,
        "reason": summary.reason,
        "wall_s": result.wall_s,
        "bus_faults": summary.bus_faults,
        "faults_injected": result.outcome.faults,
        "telemetry_drops": summary.telemetry_drops,
    }
    if result.reference is not None:
        timing["probe_jitter"], timing["reference_jitter"] = (
            timing["reference_jitter"], result.reference
        )  # fmt: skip
    timing["bus_plan"] = tick_budget.plan_times(result.plan)
    timing["account"] = tick_budget.measure_budget(
        result.records, options.period_s, timing["bus_plan"], timing["reference_jitter"]
    )
    programme = sil_artifacts.programme_s(options)
    timing["run"]["programme_s"] = programme
    timing["prediction_error"] = sil_artifacts.prediction_error(
        result.records, result.outcome.truth, programme
    )
    (out / "timing.json").write_text(json.dumps(timing, indent=1), encoding="utf-8")
    (out / "timing.xml").write_bytes(timing_verdict.junit_xml(timing))
    if result.geometry and timing["prediction_error"]["n"]:
        write_trial(sil_artifacts.as_trial(result, options), out / "trial")
    sil_artifacts.draw_summary(result, timing, out / "summary.svg")
    _write_evidence(result, timing["budget"]["period_ns"], out)
    return timing


def _write_evidence(result: sil.SilResult, period_ns: int, out: Path) -> None:
    records = result.records
    for name, durations_ns in {
        "tick": records["lateness_ns"] + records["busy_ns"],
        "own_cost": records["busy_ns"] - records["bus_wait_ns"],
        "lateness": records["lateness_ns"],
        "probe_lateness": result.loop_cpu.lateness_ns,
    }.items():
        write_hgrm(out / f"{name}.hgrm", durations_ns)
    write_timeline(out / "timeline.json", records, result.loop_cpu, period_ns)


def describe_sil(timing: dict[str, Any], out: Path) -> str:
    """The result for people."""
    run_, environment, error = timing["run"], timing["environment"], timing["prediction_error"]
    lines = [
        f"{timing['verdict']}: {timing['reason']}",
        f"{run_['ended']}: {run_['reason']}; {timing['ticks']} ticks in {run_['wall_s']:.1f} s on "
        f"the {environment['line']} line",
    ]
    if environment["line"] == "virtual":
        lines.append(
            f"{environment['speed_up']:.0f} times real time, "
            f"{environment['speed_up_by_processor_time']:.0f} times by processor time"
        )
    else:
        lines += [*_timing_lines(timing), *tick_budget.describe_budget(timing["account"])]
        lines += environment["refused"]
    if error["n"]:
        lines.append(
            f"predicted tip off by {error['mean_euclidean_distance_m'] * 1e3:.1f} mm on average, "
            f"{error['max_m'] * 1e3:.1f} mm at most"
        )
        lines += [
            f"  {name.replace('_', ' '):12} {part['mean_euclidean_distance_m'] * 1e3:5.1f} mm, "
            f"{part['max_m'] * 1e3:5.1f} mm at most, interval covers "
            f"{100 * part['interval_coverage']:.1f} %"
            for name, part in error["parts"].items()
        ]
    lines.append(f"see {out}/summary.svg and timing.json")
    return "\n".join(lines)


def _timing_lines(timing: dict[str, Any]) -> list[str]:
    cost = timing["own_cost"]
    met = "met" if cost["within_budget"] else "not met"
    causes = ", ".join(f"{count} {cause}" for cause, count in timing["causes"].items())
    rows = {
        "own cost": cost,
        "wake-up": timing["lateness"],
        "beside it": timing["reference_jitter"],
    }
    shares = (("p50", "p50_ns"), ("p99", "p99_ns"), ("p99.9", "p99_9_ns"), ("max", "max_ns"))
    return [
        *(
            f"{name:9} " + ", ".join(f"{label} {row[key] / 1e3:.0f} µs" for label, key in shares)
            for name, row in rows.items()
        ),
        f"target for the own cost, p50 {timing_verdict.OWN_COST_P50_NS / 1e3:.0f} µs, "
        f"p99 {timing_verdict.OWN_COST_P99_NS / 1e3:.0f} µs: {met}",
        f"misses {timing['misses']} ({causes}); with 95 % confidence ours are fewer than 1 in "
        f"{1 / timing['own_miss_rate_upper_bound_95']:.0f}",
    ]
