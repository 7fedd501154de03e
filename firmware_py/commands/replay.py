"""Replay of a log through a bundle: comparison of DI, payload and tip with the recorded values.

Without a log the bundle's golden ticks are replayed, as at the start-up of the robot.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.signals import DI, PAYLOAD, tip_names
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import SampleHold
from firmware_py.inference.golden import TOLERANCE
from firmware_py.log.recording import LoggedRun, Recording, logged_run, read_recording
from firmware_py.safety.states import SafetyState
from firmware_py.tick_log import LONGEST_STEP_SLOTS

EXAMPLE = "dropstitch replay logs/20261121T093000Z_sinusoid.mcap --bundle build/bundle_1dof"

_COMPARED = (DI.name, PAYLOAD.name, *tip_names("predicted_"))


class Seams(NamedTuple):
    """Discontinuities of a log."""

    # (n,), rows at which the robot started again after a disconnect, with a reset estimator
    restarted: NDArray[np.bool_]
    missing: int  # Ticks that ran but are missing in the log


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", type=Path, nargs="?", help="MCAP log of 'dropstitch run'")
    parser.add_argument(
        "--bundle",
        type=Path,
        metavar="BUNDLE",
        help="bundle to replay through (default: the one of the log)",
    )


def run(args: argparse.Namespace) -> int:
    """Compare; the verdict is negative if a value differs by more than the tolerance."""
    if args.log is None:
        if args.bundle is None:
            raise InputError("replay", "has neither a log nor a bundle", "name one of them")
        bundle = ModelBundle.load(args.bundle)
        emit(
            args,
            {"bundle": str(args.bundle), "golden": "agree"},
            f"{args.bundle}: {bundle.manifest.dof} joints, estimator "
            f"{bundle.manifest.estimator}; the golden ticks agree",
        )
        return DONE
    log = read_recording(args.log)
    bundle = ModelBundle.load(args.bundle or _bundle_of(args.log, log))
    differences = compare(log, bundle)
    worst, seams = max(differences.values()), find_seams(log)
    agree = worst <= TOLERANCE
    result: dict[str, Any] = {
        "log": str(args.log),
        "bundle": str(bundle.directory),
        "ticks": len(log.columns["tick"]),
        "complete": log.complete,
        "missing_ticks": seams.missing,
        "restarts": int(seams.restarted.sum()),
        "agree": agree,
        "largest_difference": differences,
    }
    lines = [f"{name}: largest difference {value:.3g}" for name, value in differences.items()]
    lines.append(
        f"{result['ticks']} ticks{'' if log.complete else ' of a log that was cut off'} "
        + ("agree" if agree else f"differ by more than {TOLERANCE:g}")
    )
    if seams.missing:
        lines.append(
            f"the log lacks {seams.missing} ticks that ran: from the first of them on the estimate "
            "may differ though the bundle is the right one"
        )
    emit(args, result, "\n".join(lines))
    return DONE if agree else NEGATIVE


def _bundle_of(path: Path, log: Recording) -> Path:
    directory = Path(log.metadata.get("bundle", ""))
    if not directory.is_dir():
        raise InputError(path, f"its bundle {directory} is missing", "name one with --bundle")
    return directory


def find_seams(log: Recording) -> Seams:
    """Find the restarts of a run, and count the missing ticks of its log."""
    columns = log.columns
    count = len(columns["missed"])
    state = columns.get("state", np.zeros(count))
    restarted = np.zeros(count, dtype=bool)
    # Only the return of a port leads out of a stop, see `firmware_py.safety.states`.
    restarted[1:] = (state[:-1] >= SafetyState.STOPPING) & (state[1:] < state[:-1])
    slot = columns.get("tick", np.cumsum(columns["missed"] + 1))
    apart = np.diff(slot) - 1 - columns["missed"][1:]
    lacking = np.nan_to_num(np.where(restarted[1:], 0, apart))
    return Seams(restarted, int(np.maximum(lacking, 0).sum()))


def compare(log: Recording, bundle: ModelBundle) -> dict[str, float]:
    """Run a log's measurements through a bundle's estimator and predictor.

    Returns the largest absolute difference by column, infinite if only one side has a value.
    """
    dof = bundle.manifest.dof
    if log.dof != dof:
        raise InputError(
            bundle.directory,
            f"is for {dof} joints, the log for {log.dof}",
            "name one for as many joints",
        )
    columns = log.columns
    angle_rad = np.column_stack([columns[f"angle_{j}_rad"] for j in range(1, dof + 1)])
    current_a = np.column_stack([columns[f"current_{j}_a"] for j in range(1, dof + 1)])
    facts = logged_run(log)
    if facts.period_s is None:
        raise InputError(log.path, "its metadata give no period_s", "name another log")
    step_s = facts.period_s * np.minimum(columns["missed"] + 1, LONGEST_STEP_SLOTS)
    recorded = np.column_stack([columns[name] for name in _COMPARED])
    replayed = np.empty_like(recorded)
    bundle.assume_payload(facts.assumed_payload_kg)
    hold = SampleHold(bundle.estimator)
    hold.reset()
    fresh = columns.get("stale_ticks", np.zeros(len(replayed))) == 0
    # Logs without this column come from a loop that treated every sample as punctual.
    late_s = np.nan_to_num(columns.get("sample_late_ns", np.zeros(len(replayed)))) * 1e-9
    slot = columns.get("tick", np.zeros(len(replayed)))
    end_of_probe = int(np.argmax(slot >= 0)) if facts.probed else -1
    restarted = find_seams(log).restarted
    for k, (angle, current) in enumerate(zip(angle_rad, current_a, strict=True)):
        if restarted[k]:
            hold.reset()
        estimate = hold.update(angle, current, float(step_s[k]), bool(fresh[k]), float(late_s[k]))
        tip_m = bundle.predictor.predict(
            angle, current, estimate.di, estimate.signals, hold.age_s
        ).tip_m
        replayed[k] = (estimate.di, estimate.payload_kg, *tip_m)
        if k == end_of_probe and slot[k] >= 0:
            bundle.assume_payload(_assumed_payload_kg(facts, columns["payload_kg"][k + 1 :]))
    difference = np.abs(replayed - recorded)
    difference[np.isnan(replayed) & np.isnan(recorded)] = 0.0
    difference[np.isnan(difference)] = np.inf
    return dict(zip(_COMPARED, difference.max(axis=0).tolist(), strict=True))


def _assumed_payload_kg(facts: LoggedRun, later_kg: NDArray[np.float64]) -> float | None:
    """Return the payload that a probing motion set in the observer; None if it was estimated.

    A payload that was set is constant in all later ticks; an estimate changes.
    """
    if facts.assumed_payload_kg is not None or not len(later_kg):
        return facts.assumed_payload_kg
    return float(later_kg[0]) if np.all(later_kg == later_kg[0]) else None
