"""Variables of a MATLAB file up to version 7, bounded before they are read."""

from __future__ import annotations

import warnings
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from firmware_py.display_units import DATA_SIZE
from firmware_py.errors import InputError
from firmware_py.files.input_files import MOST_CELLS, read_bytes

MATRIX_COLUMNS: Final = 32
"""Most columns of a matrix whose columns count as channels sampled together."""
MOST_UNPACKED_BYTES: Final = 150_000_000
"""Most unpacked bytes of a file's compressed variables: those of `MOST_CELLS` numbers, and as much
again for variables that are not used."""
_COMPRESSED: Final = 15
"""Type of a compressed element (MAT-File Format, R2019b, table 1-1)."""
_HEADER_BYTES: Final = 128
_REMEDY: Final = "save it with -v7"


def matlab_variables(path: Path) -> dict[str, Any]:
    """Read the variables of a MATLAB file, by name."""
    import io

    from scipy.io import loadmat

    data = read_bytes(path, "name an existing MATLAB file")
    _check_unpacked(path, data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for example of two variables with one name
            variables = loadmat(io.BytesIO(data))
    except MemoryError:
        raise
    except Exception as error:  # scipy passes on any error of its parser
        what = f"is not a MATLAB file up to version 7 ({type(error).__name__}: {error})"
        raise InputError(path, what, _REMEDY) from None
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def matlab_scalars(path: Path) -> dict[str, str | int | float]:
    """Single values of a MATLAB file by name."""
    single = {n: np.ravel(v)[0] for n, v in matlab_variables(path).items() if np.size(v) == 1}
    plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in single.items()}
    return {n: v for n, v in plain.items() if isinstance(v, str | int | float)}


def matlab_columns(path: Path) -> dict[str, Any]:
    """Vectors of a MATLAB file, and the columns of its matrices as `name[k]`."""
    columns: dict[str, Any] = {}
    cells = 0
    for name, value in matlab_variables(path).items():
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
            continue
        cells += value.size
        if cells > MOST_CELLS:
            raise InputError(path, f"holds more than {MOST_CELLS} numbers", "divide it")
        if value.size == max(value.shape, default=0) > 1:
            columns[name] = value.ravel()
        elif value.ndim == 2 and 1 < value.shape[1] <= MATRIX_COLUMNS < len(value):
            columns |= {f"{name}[{k}]": rows for k, rows in enumerate(value.T)}
    return columns


def _check_unpacked(path: Path, data: bytes) -> None:
    """Refuse compressed variables that unpack to too much, before they are unpacked."""
    order = "big" if data[126:128] == b"MI" else "little"
    at, total = _HEADER_BYTES, 0
    while data[124:126] in (b"\x00\x01", b"\x01\x00") and at + 8 <= len(data):
        kind = int.from_bytes(data[at : at + 4], order)  # type: ignore[arg-type]
        size = int.from_bytes(data[at + 4 : at + 8], order)  # type: ignore[arg-type]
        if kind == _COMPRESSED:
            total += _unpacked_bytes(memoryview(data)[at + 8 : at + 8 + size], total)
        if total > MOST_UNPACKED_BYTES:
            what = f"unpacks to more than {DATA_SIZE.number(MOST_UNPACKED_BYTES)} MB"
            raise InputError(path, what, "save only the variables that are needed")
        at += 8 + size


def _unpacked_bytes(packed: memoryview, before: int) -> int:
    """Size of an unpacked element, counted in pieces up to the first damaged byte."""
    unpack, size = zlib.decompressobj(), 0
    try:
        piece = unpack.decompress(packed, 1 << 20)
        while piece:
            size += len(piece)
            if before + size > MOST_UNPACKED_BYTES:
                break
            piece = unpack.decompress(unpack.unconsumed_tail, 1 << 20)
    except zlib.error:
        pass
    return size
