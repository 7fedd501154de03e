"""Files of 100 MB by reader: valid ones, and ones made to take memory or time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Final

from bench.files import large_bundle_files as of_bundle
from bench.files import large_recordings as recorded
from bench.files.file_filling import MARKERS, STEP_S, angle_rad, filled, filled_by_lines, marker_m
from firmware_py.files.input_files import MOST_BYTES, MOST_JSON_BYTES

__all__ = ["LARGE_FILES", "LargeFile"]

LargeFile = Callable[[Path], None]
"""Writes one file."""
_AXES: Final = "xyz"


def trial_csv(path: Path) -> None:
    """Trial of one joint with markers."""
    names = ["time_s", "goal_1_rad", "angle_1_rad", "current_1_a"]
    names += [f"{m}_{a}_m" for m in ("tip", *MARKERS) for a in _AXES]

    def line(k: int) -> str:
        angle = angle_rad(k)
        places = [v for m in (12, *range(16)) for v in marker_m(m, angle)]
        cells = [k * STEP_S, angle, angle, 0.1, *places]
        return ",".join([f"{cell:.8f}" for cell in cells]) + "\n"

    filled_by_lines(path, ",".join(names) + "\n", line)


def motive_csv(path: Path) -> None:
    """Export of Motive at 120 Hz."""
    triples = [m for m in MARKERS for _ in _AXES]
    head = [
        ["Format Version", "1.23", "Length Units", "Meters", "Coordinate Space", "Global"], [],
        ["", "Type", *["Marker"] * 48], ["", "Name", *triples], ["", "ID", *["1"] * 48],
        ["", "", *["Position"] * 48], ["Frame", "Time (Seconds)", *["X", "Y", "Z"] * 16],
    ]  # fmt: skip

    def line(k: int) -> str:
        angle = angle_rad(k // 2)
        cells = [f"{v:.8f}" for m in range(16) for v in marker_m(m, angle)]
        return ",".join([str(k), f"{k / 120:.6f}", *cells]) + "\n"

    filled_by_lines(path, "\n".join(map(",".join, head)) + "\n", line)


def json_records(path: Path) -> None:
    """Records of a servo's log."""

    def line(k: int) -> str:
        angle = angle_rad(k)
        record = {"time_s": k * STEP_S, "goal_1_rad": angle, "angle_1_rad": angle}
        return (",\n" if k else "") + json.dumps(record | {"current_1_a": 0.1, "note": "x" * 250})

    filled_by_lines(path, "[", line, MOST_JSON_BYTES - 1)
    with path.open("a", encoding="utf-8") as file:
        file.write("]")


def json_short_records(path: Path) -> None:
    """As many records of as many numbers as are permitted."""
    record = b'{"a":1.5,"b":2.5,"c":3.5,"d":4.5,"e":5.5,"f":6.5,"g":7.5}'
    filled(path, b"[" + record, b",\n" + record, 490_000 * (len(record) + 2))
    with path.open("ab") as file:
        file.write(b"]")


def wide_text(path: Path) -> None:
    """Millions of short texts, each with a character of four bytes."""
    text = '"😀xxxxxxxx"'.encode()
    filled(path, b"[" + text, b"," + text, 3_900_000 * (len(text) + 1))
    with path.open("ab") as file:
        file.write(b"]")


def long_plant(path: Path) -> None:
    """Plant with a long text."""
    root = Path(__file__).parents[2] / "models" / "plant" / "examples"
    document = json.loads((root / "xl330_pendulum_identified.json").read_text(encoding="utf-8"))
    document["name"] = "x" * (MOST_JSON_BYTES - 100_000)
    path.write_text(json.dumps(document), encoding="utf-8")


def _of(head: bytes, block: bytes, size: int = MOST_BYTES) -> LargeFile:
    return lambda path: filled(path, head, block, size)


_JSON: Final = MOST_JSON_BYTES
_HEAD: Final = b"time_s,goal_1_rad,angle_1_rad,current_1_a\n"
_MOTIVE: Final = b"Format Version,1.23,Length Units,Meters\n"

LARGE_FILES: Final[dict[str, dict[str, LargeFile]]] = {
    "trial.csv": {
        "valid": trial_csv, "new lines": _of(_HEAD, b"\n"), "commas": _of(b"", b","),
        "one line": _of(_HEAD, b"1"), "quotes": _of(_HEAD, b'"'),
    },
    "table.csv": {
        "valid": trial_csv, "new lines": _of(_HEAD, b"\n"), "commas": _of(b"", b","),
        "one line": _of(_HEAD, b"1"), "quotes": _of(_HEAD, b'"'),
        "short rows": _of(_HEAD, b"1,1,1,1\n"),
    },
    "table.json": {
        "valid": json_records, "short records": json_short_records,
        "brackets": _of(b"", b"[", _JSON), "numbers": _of(b"[1", b",1", _JSON),
        "wide text": wide_text, "digits": _of(b"[", b"9", _JSON),
        "100 MB": _of(b"[", b" "),
    },
    "table.mat": {
        "valid": recorded.matlab, "valid, packed": recorded.matlab_packed,
        "many variables": recorded.matlab_many, "bomb": recorded.matlab_bomb,
        "zeros": _of(recorded.matlab_head(), bytes(8)),
    },
    "log.mcap": {
        "valid": recorded.log, "metadata": recorded.log_of_metadata, "chunks": recorded.log_chunks,
        "zeros": _of(recorded.MCAP, bytes(9)),
    },
    "take.csv": {
        "valid": motive_csv, "new lines": _of(b"", b"\n"), "header": _of(_MOTIVE, b",,,\n"),
        "commas": _of(_MOTIVE, b","),
    },
    "take.c3d": {
        "valid": recorded.c3d, "claims": recorded.c3d_claims, "zeros": _of(b"", bytes(512)),
    },
    "bag": {
        "valid": recorded.bag, "short messages": recorded.bag_short,
        "endless": recorded.bag_endless,
    },
    "map.toml": {
        "tables": _of(b"", b"[[a]]\n", 10**6), "names": _of(b"", b"a.", 10**6),
        "numbers": _of(b"a=[", b"1,", 10**6), "100 MB": _of(b"", b"#"),
    },
    "plant.json": {
        "valid": long_plant, "wide text": wide_text, "short records": json_short_records,
        "digits": _of(b"[", b"9", _JSON),
        "numbers": _of(b"[1", b",1", _JSON), "lists": _of(b"[[]", b",[]", 1_490_000),
    },
    "plan.json": {
        "wide text": wide_text, "short records": json_short_records,
    },
    "golden.npz": {"valid": of_bundle.npz, "bomb": of_bundle.npz_bomb},
    "predictor.onnx": {
        "valid": of_bundle.onnx_weights, "bomb": of_bundle.onnx_bomb, "zeros": _of(b"", bytes(8)),
    },
    "observer.fmu": {
        "large": of_bundle.fmu_large, "elements": of_bundle.fmu_xml,
        "entities": of_bundle.fmu_bomb,
    },
}  # fmt: skip
"""Files by the name that their reader knows, and by what is in them."""
