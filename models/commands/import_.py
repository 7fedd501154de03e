"""Import of recordings as trials: names and units mapped, files merged, clocks synchronised.

Every import is checked against the nominal link and gets a page, OUT/NAME.html, that shows the
findings. An import that cannot be right is refused with its likely cause, a doubtful one warned
of. Several files, or a folder, are imported with one map; conditions then come from their names or
from a table ([takes] in the map, docs/trials.md). An import replaces only trials of the same
recordings: neither a file that is read nor any other trial.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec

from firmware_py.core.console import BAD_INPUT, DONE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.guarded_call import SECONDS, guarded_call
from firmware_py.core.input_files import MOST_BYTES
from firmware_py.core.units import DURATION
from models.commands.output_paths import check_output_directory
from models.trials.files import check_trial_name
from models.trials.pipeline import Source, import_take
from models.trials.recordings import KINDS
from models.trials.recordings.mapping import RecordingMap, Take, find_takes, read_mapping

SECONDS_PER_BYTE: Final = 2e-6
"""Processor time by the size of a recording: five times that of a bag of joint states
[measured]."""
EXAMPLE = "dropstitch import take_001.csv --as motive --servo run.mcap --map map.toml --out trials"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, nargs="+", metavar="FILE", help="recordings to import, or their folder"
    )
    parser.add_argument(
        "--as", dest="kind", required=True, choices=KINDS, help="format of the recordings"
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
    mapping = read_mapping(args.map)
    takes = find_takes(args.file, args.kind, mapping)
    if len(takes) == 1:
        name = args.name or takes[0].file.stem
        _check_replaced(args, takes, mapping, [name])
        result = _import(args, takes[0], name)
        emit(args, result, _described(result))
        return DONE
    _check_replaced(args, takes, mapping, [take.file.stem for take in takes])
    for option in ("servo", "name", "offset"):
        if getattr(args, option) is not None:
            raise InputError(
                f"--{option}", f"belongs to one file, not to {len(takes)}", "give it under [takes]"
            )
    results, texts = [], []
    for take in takes:
        try:
            result = _import(args, take, take.file.stem)
            texts.append(_described(result))
        except InputError as error:
            result = {"file": str(take.file), "verdict": "refused", "why": str(error)}
            texts.append(f"refused: {error}")
        results.append(result)
    refused = sum(result["verdict"] == "refused" for result in results)
    imported = f"{len(takes) - refused} of {len(takes)} takes imported"
    emit(args, {"takes": results}, "\n".join([*texts, imported]))
    return BAD_INPUT if refused else DONE


def _check_replaced(
    args: argparse.Namespace, takes: list[Take], mapping: RecordingMap, names: list[str]
) -> None:
    """Refuse, before any work, an output that would replace an input."""
    beside = [mapping.link, mapping.plant, mapping.takes.table] if args.map else []
    inputs = [
        *(take.file for take in takes), *(take.servo for take in takes), args.servo, args.map,
        *(args.map.parent / name for name in beside if name),
    ]  # fmt: skip
    read = {key: path for path in inputs if path and (key := _file_key(path))}
    written = [f"{name}{suffix}" for name in names for suffix in (".csv", ".toml", ".html")]
    replaced = [file for file in written if _file_key(args.out / file) in read]
    check_output_directory(args.out, replaced, read.values())


def _file_key(path: Path) -> tuple[int, int] | None:
    """Device and inode of an existing file, whatever link or spelling leads to it."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def _import(args: argparse.Namespace, take: Take, name: str) -> dict[str, Any]:
    """Import one take in a child process with limits of memory and time.

    Libraries that read binary formats crash or allocate without bound on damaged files.
    """
    check_trial_name(name, "--name")
    args.out.mkdir(parents=True, exist_ok=True)
    servo = args.servo or take.servo
    offset_s = args.offset if args.offset is not None else take.offset_s
    source = Source(take.file, args.kind, servo, offset_s)
    with TemporaryDirectory(prefix=".import-", dir=args.out) as scratch:
        answer = guarded_call(
            lambda: msgspec.json.encode(
                import_take(source, take.mapping, name, args.out, Path(scratch))
            ),
            take.file, "export it again, or import less of it", seconds=_seconds_for(source),
        )  # fmt: skip
        result: dict[str, Any] = msgspec.json.decode(answer)
        for file in sorted(Path(scratch).iterdir()):  # the CSV first: a trial needs both
            file.replace(args.out / file.name)
    for finding in result["findings"]:
        print(f"warning: {take.file}: {finding['text']}; {finding['remedy']}.", file=sys.stderr)
    return result


def _seconds_for(source: Source) -> float:
    """Limit of the processor time for files of this size; unreadable files are refused later."""
    size = 0
    for path in filter(None, (source.file, source.servo)):
        with contextlib.suppress(OSError, ValueError):
            files = path.iterdir() if path.is_dir() else (path,)
            size += sum(file.stat().st_size for file in itertools.islice(files, 100))
    return SECONDS + min(size, 2 * MOST_BYTES) * SECONDS_PER_BYTE


def _described(result: dict[str, Any]) -> str:
    text = (
        f"{result['trial']}: {result['rows']} rows of "
        f"{DURATION.factor * result['step_s']:.3g} ms, {result['rest_samples']} at rest"
    )
    if result["occluded_share"] is not None:
        text += f", {result['occluded_share']:.1%} of the marker cells empty"
    for key in ("clock", "lean"):
        text += f"; {result[key]}" if key in result else ""
    for name in result["cut_off"]:
        text += f"; {name} was cut off: read up to its last whole chunk"
    warned = len(result["findings"])
    return f"{text}; {warned or 'no'} warning{'s' if warned != 1 else ''}, see {result['page']}"
