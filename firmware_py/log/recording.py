"""Log file of a run: an MCAP file with one message per tick.

`firmware_py.log.recorder` writes it from another process. `read_recording` reads it; a file that
was cut off is read up to its last complete chunk. The packages mcap and lz4 are not imported by the
process of the loop while it runs.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.signals import tick_signals

__all__ = ["Recording", "read_recording"]

TOPIC: Final = "/tick"
METADATA: Final = "dropstitch"
SCHEMA_NAME: Final = "dropstitch.Tick"
CHUNK_BYTES: Final = 16 * 1024
"""Size of a chunk: a third of a second of two joints, the largest loss if recorder or power fail.
Chunks of four times the length make the file 9 % smaller, of half the length 10 % larger."""

_DAMAGE: Final = (
    EOFError, LookupError, OverflowError, RuntimeError, ValueError, struct.error,
    msgspec.MsgspecError,
)  # fmt: skip
"""Errors beside mcap's own that a truncated or damaged file raises."""


@dataclass(frozen=True)
class Recording:
    """Contents of a log file.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
        Values by name of the signal (`firmware_py.signals.tick_signals`), exact; NaN where the log
        has null. Integers are integers.
    metadata : dict of str to str
        Facts about the run, see `firmware_py.robot.log_metadata`; `dof` is added.
    complete : bool
        False where the file was cut off.
    """

    columns: dict[str, NDArray[Any]]
    metadata: dict[str, str]
    complete: bool

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self.metadata["dof"])


def tick_schema(dof: int) -> dict[str, Any]:
    """Return the JSON Schema of a tick, with unit and meaning of every column."""
    return {
        "title": SCHEMA_NAME,
        "type": "object",
        "properties": {
            s.name: {"type": "number", "unit": s.unit, "description": s.description}
            for s in tick_signals(dof)
        },
    }


def require_packages() -> None:
    """Check that the packages of the log file are installed.

    Raises
    ------
    InputError
        If mcap or lz4 is missing.
    """
    missing = [name for name in ("mcap", "lz4") if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            "record", f"needs the packages mcap and lz4 ({', '.join(missing)} missing)",
            "pip install 'dropstitch[record]', or set record = false in robot.toml",
        )  # fmt: skip


def _number(value: int | float | str | None) -> int | float:
    """Invert `firmware_py.log.sinks.TickEncoder`: null is NaN, an infinity a string."""
    if value is None:
        return np.nan
    return float(value) if isinstance(value, str) else value


def read_recording(path: Path | str) -> Recording:
    """Read a log file.

    Parameters
    ----------
    path : Path or str
        The file.

    Raises
    ------
    InputError
        If a package or the file is missing, or it is no log of this project, or holds no tick.
    """
    require_packages()
    from mcap.exceptions import McapError
    from mcap.records import Message, Metadata
    from mcap.stream_reader import StreamReader

    path = Path(path)
    if not path.is_file():
        raise InputError(path, "is missing", "name a log that 'dropstitch run' has written")
    rows: list[dict[str, int | float | str | None]] = []
    metadata: dict[str, str] = {}
    complete = False
    decode = msgspec.json.Decoder(dict[str, int | float | str | None]).decode
    # From memory: a damaged length then gets the bytes that are left, however large it is.
    stream = io.BytesIO(path.read_bytes())
    with contextlib.suppress(McapError, *_DAMAGE):
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Message):
                rows.append(decode(record.data))
            elif isinstance(record, Metadata) and record.name == METADATA:
                metadata = dict(record.metadata)
        complete = True
    if "dof" not in metadata:
        raise InputError(
            path, "is not a log of dropstitch", "name one that 'dropstitch run' has written"
        )
    if not rows:
        raise InputError(path, "holds no whole chunk of ticks", "record for longer")
    return Recording(
        {
            s.name: np.array([_number(row.get(s.name)) for row in rows])
            for s in tick_signals(int(metadata["dof"]))
        },
        metadata,
        complete,
    )
