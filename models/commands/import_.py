"""Import of a recording as a trial: names and units mapped, files merged, clocks synchronised."""

from __future__ import annotations

import argparse
import contextlib
import itertools
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.console import DONE, emit
from firmware_py.display_units import DURATION
from firmware_py.files.guarded_call import SECONDS, guarded_call
from firmware_py.files.input_files import MOST_BYTES
from firmware_py.log.recording import read_recording
from models.trials.importers import KINDS, read_series
from models.trials.importers.assembly import align_rest_pose, assemble_trial
from models.trials.importers.mapping import read_mapping
from models.trials.importers.robot_log import with_log_conditions
from models.trials.importers.synchronisation import shift_clock, synchronise
from models.trials.importers.table_file import read_scalars
from models.trials.trial_files import check_trial_name, read_trial, write_trial

SECONDS_PER_BYTE: Final = 2e-6
"""Processor time by the size of a recording: five times that of a bag of joint states
[measured]."""
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
    """Import one recording and check the written trial as any other.

    The work is done in a child process with limits of memory and time: libraries that read binary
    formats crash or allocate without bound on damaged files.

    Raises
    ------
    InputError
        If a file cannot be used, or the name of the trial is none.
    """
    name = args.name or args.file.stem
    check_trial_name(name, "--name")
    args.out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".import-", dir=args.out) as scratch:
        answer = guarded_call(
            lambda: msgspec.json.encode(_import(args, name, Path(scratch))), args.file,
            "export it again, or import less of it", seconds=_seconds_for(args.file, args.servo),
        )  # fmt: skip
        result: dict[str, Any] = msgspec.json.decode(answer)
        for file in sorted(Path(scratch).iterdir()):  # the CSV first: a trial needs both
            file.replace(args.out / file.name)
    emit(args, result, _described(result))
    return DONE


def _import(args: argparse.Namespace, name: str, out: Path) -> dict[str, Any]:
    """Facts about the trial that is written to `out`."""
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
    path = write_trial(assemble_trial(series, mapping, name), out)
    trial = read_trial(path, mapping.signals)
    return result | {
        "trial": str(args.out / path.name),
        "rows": len(trial),
        "step_s": trial.step_s,
        "rest_samples": trial.meta.rest_samples,
        "occluded_share": None if mapping.signals else float(np.mean(np.isnan(trial.markers_m))),
        "cut_off": cut_off,
    }


def _described(result: dict[str, Any]) -> str:
    """Result for people."""
    text = (
        f"{result['trial']}: {result['rows']} rows of "
        f"{DURATION.factor * result['step_s']:.3g} ms, {result['rest_samples']} at rest"
    )
    if result["occluded_share"] is not None:
        text += f", {result['occluded_share']:.1%} of the marker cells empty"
    if "correlation" in result:
        text += (
            f"; servo clock {result['offset_s']:+.4f} s, correlation {result['correlation']:.4f}"
        )
    for name in result["cut_off"]:
        text += f"; {name} was cut off: read up to its last whole chunk"
    return text


def _seconds_for(*paths: Path | None) -> float:
    """Processor time for files of this size; what cannot be read is refused later."""
    size = 0
    for path in filter(None, paths):
        with contextlib.suppress(OSError, ValueError):
            files = path.iterdir() if path.is_dir() else (path,)
            size += sum(file.stat().st_size for file in itertools.islice(files, 100))
    return SECONDS + min(size, 2 * MOST_BYTES) * SECONDS_PER_BYTE


def _is_recording(path: Path | None) -> bool:
    return path is not None and path.suffix == ".mcap"
