"""Import of a recording as a trial: names and units mapped, files merged, clocks synchronised."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from firmware_py.console import DONE, emit
from firmware_py.display_units import DURATION
from firmware_py.log.recording import read_recording
from models.trials.importers import KINDS, read_series
from models.trials.importers.assembly import align_rest_pose, assemble_trial
from models.trials.importers.mapping import read_mapping
from models.trials.importers.robot_log import with_log_conditions
from models.trials.importers.synchronisation import shift_clock, synchronise
from models.trials.importers.table_file import read_scalars
from models.trials.trial_files import read_trial, write_trial

EXAMPLE = (
    "python -m models import take_001.csv --as motive --servo run.mcap --map map.toml --out trials"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("file", type=Path, metavar="FILE", help="recording to import")
    parser.add_argument(
        "--as", dest="kind", required=True, choices=KINDS, help="format of the recording"
    )
    parser.add_argument(
        "--servo", type=Path, metavar="LOG",
        help="second file with angle, current and goal: .mcap log of dropstitch run, or a table",
    )  # fmt: skip
    parser.add_argument(
        "--offset", type=float, metavar="SECONDS",
        help="add this to the times of --servo instead of finding the offset by correlation",
    )  # fmt: skip
    parser.add_argument(
        "--map", type=Path, metavar="MAP.toml",
        help="names, units, frame and conditions (docs/trials.md)",
    )  # fmt: skip
    parser.add_argument("--name", help="name of the trial (default: that of FILE)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where trials go")


def run(args: argparse.Namespace) -> int:
    """Import one recording and check the written trial as any other."""
    mapping = read_mapping(args.map)
    cut_off = []
    for path in filter(_is_recording, (args.file, args.servo)):
        log = read_recording(path)
        mapping = with_log_conditions(mapping, log)
        if not log.complete:
            cut_off.append(str(path))
    if args.kind == "table":
        mapping = mapping.with_scalars(read_scalars(args.file), args.file)
    series = align_rest_pose(read_series(args.file, args.kind, mapping), mapping)
    result: dict[str, Any] = {}
    if args.servo is not None:
        servo = read_series(args.servo, None, mapping.for_servo())
        if args.offset is None:
            found = synchronise(servo, series, mapping.dof)
            result = {"offset_s": found.offset_s, "correlation": found.correlation}
        else:
            result = {"offset_s": args.offset}
        series = [*series, *shift_clock(servo, result["offset_s"])]
    trial = assemble_trial(series, mapping, args.name or args.file.stem)
    path = write_trial(trial, args.out)
    trial = read_trial(path, mapping.signals)
    result |= {
        "trial": str(path),
        "rows": len(trial),
        "step_s": trial.step_s,
        "rest_samples": trial.meta.rest_samples,
        "occluded_share": None if mapping.signals else float(np.mean(np.isnan(trial.markers_m))),
        "cut_off": cut_off,
    }
    rest = trial.meta.rest_samples
    text = f"{path}: {len(trial)} rows of {DURATION.factor * trial.step_s:.3g} ms, {rest} at rest"
    if not mapping.signals:
        text += f", {result['occluded_share']:.1%} of the marker cells empty"
    if "correlation" in result:
        text += (
            f"; servo clock {result['offset_s']:+.4f} s, correlation {result['correlation']:.4f}"
        )
    for name in cut_off:
        text += f"; {name} was cut off: read up to its last whole chunk"
    emit(args, result, text)
    return DONE


def _is_recording(path: Path | None) -> bool:
    return path is not None and path.suffix == ".mcap"
