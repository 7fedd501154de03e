"""Log file of a run: an MCAP file with one message per tick, and the facts about the run in it.

`firmware_py.log.recorder` writes it in another process. `read_recording` reads it; a truncated file
is read up to its last complete chunk. The process of the loop does not import the packages mcap and
lz4 while it runs.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import io
import math
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_bytes
from firmware_py.core.signals import tick_dtype, tick_signals

TOPIC: Final = "/tick"
METADATA: Final = "dropstitch"
SCHEMA_NAME: Final = "dropstitch.Tick"
CHUNK_BYTES: Final = 16 * 1024
"""Size of a chunk: a third of a second with two joints, the largest loss if recorder or power fail.
Chunks four times as long make the file 9 % smaller, half as long 10 % larger."""

MOST_CHUNK_BYTES: Final = 4_000_000
"""Size of the largest chunk that is read: other programs write chunks of a megabyte."""
MOST_TICKS: Final = 500_000
"""Most ticks of a log: 180 MB with two joints, 2.4 hours at 17 ms."""


@dataclass(frozen=True, repr=False)
class Recording:
    """Contents of a log file.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
        Exact values by name of the signal (`firmware_py.core.signals.tick_signals`) in SI units,
        one per tick; NaN where the log has null. Integer signals have an integer type.
    metadata : dict of str to str
        Facts about the run, see `firmware_py.robot.log_metadata`, and `dof`.
    complete : bool
        False if the file is truncated.
    path : Path
        The file, for messages.

    Examples
    --------
    >>> columns = {"time_s": np.arange(3) * 0.017, "angle_1_rad": np.zeros(3)}
    >>> Recording(columns, {"dof": "1"}, complete=True)
    <Recording log: 3 ticks, 1 joint>
    """

    columns: dict[str, NDArray[Any]]
    metadata: dict[str, str]
    complete: bool
    path: Path = Path("log")

    def __repr__(self) -> str:
        ticks = len(next(iter(self.columns.values()), ()))
        cut = "" if self.complete else ", truncated"
        return (
            f"<Recording {self.path}: {ticks} ticks, {self.dof} joint{'s' * (self.dof > 1)}{cut}>"
        )

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self.metadata["dof"])


def tick_schema(dof: int) -> dict[str, Any]:
    return {
        "title": SCHEMA_NAME,
        "type": "object",
        "properties": {
            s.name: {"type": "number", "unit": s.unit, "description": s.description}
            for s in tick_signals(dof)
        },
    }


def require_packages() -> None:
    missing = [name for name in ("mcap", "lz4") if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            "record", f"needs the packages mcap and lz4 ({', '.join(missing)} missing)",
            "pip install 'dropstitch[record]', or set record = false in robot.toml",
        )  # fmt: skip


class _TickColumn:
    """Growing column of one signal, 8 bytes per value."""

    def __init__(self, *, whole: bool) -> None:
        self._values: array[Any] = array("q" if whole else "d")
        self._whole = whole
        self._absent: list[int] = []

    def add(self, value: int | float | str | None) -> None:
        """Add a value; null means NaN, and infinities are strings, as in `TickEncoder`."""
        if value is None and self._whole:
            self._absent.append(len(self._values))
            value = 0
        elif not self._whole:
            value = math.nan if value is None else float(value)
        self._values.append(value)  # a TypeError for text instead of an integer

    def take_back(self, count: int) -> None:
        del self._values[count:]

    def result(self) -> NDArray[Any]:
        """Return the values as integers; as doubles if the signal is one or a value is missing."""
        kind = np.int64 if self._whole else np.float64
        values: NDArray[Any] = np.frombuffer(self._values, dtype=kind)
        if self._absent:
            values = values.astype(np.float64)
            values[[k for k in self._absent if k < len(values)]] = np.nan
        return values


def read_recording(path: Path | str, first: int | None = None) -> Recording:
    """Read a log file.

    Parameters
    ----------
    path : Path or str
        The log, an MCAP file.
    first : int, optional
        Number of ticks to read; by default all.

    Returns
    -------
    Recording
        Columns and metadata; of a truncated file, those up to its last complete chunk.

    Raises
    ------
    InputError
        If a package or the file is missing, or the file is not a log of this project or has no
        tick.

    Examples
    --------
    >>> import dropstitch
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as out:
    ...     run = dropstitch.run_sil(
    ...         "docs/notebooks/bundle_1dof", out, line="virtual", seconds=2.0
    ...     )
    ...     log = read_recording(f"{out}/ticks.mcap")
    >>> log.dof, len(log.columns["angle_1_rad"]) >= 117
    (1, True)
    """
    require_packages()
    path = Path(path)
    data = read_bytes(path, "name a log that 'dropstitch run' has written")
    metadata: dict[str, str] = {}
    with contextlib.suppress(*_damage()):
        for record in _metadata(data):
            metadata = record  # the last one counts
    columns = _columns_of(metadata)
    if not columns:
        raise InputError(
            path, "is not a log of dropstitch", "name one that 'dropstitch run' has written"
        )
    complete, ticks = False, 0
    decode = msgspec.json.Decoder(dict[str, int | float | str | None]).decode
    with contextlib.suppress(*_damage()):
        for message in _messages(data):
            tick = decode(message)
            for name, column in columns.items():
                column.add(tick.get(name))
            ticks += 1
            if ticks == first:
                break
            if ticks > MOST_TICKS:
                raise InputError(path, f"holds more than {MOST_TICKS} ticks", "divide the log")
        complete = True
    if not ticks:
        raise InputError(path, "holds no whole chunk of ticks", "record for longer")
    for column in columns.values():
        column.take_back(ticks)  # the last tick may have been damaged
    results = {name: column.result() for name, column in columns.items()}
    return Recording(results, metadata, complete, path)


def _columns_of(metadata: dict[str, str]) -> dict[str, _TickColumn]:
    """Return empty columns for the joints in the metadata; none for other files."""
    if metadata.get("dof") not in ("1", "2"):
        return {}
    kinds = tick_dtype(int(metadata["dof"]))
    return {name: _TickColumn(whole=kinds[name].kind == "i") for name in kinds.names or ()}


def _damage() -> tuple[type[Exception], ...]:
    """Return the errors that a truncated or damaged file raises."""
    from mcap.exceptions import McapError

    return (
        McapError, EOFError, LookupError, OverflowError, RuntimeError, TypeError, ValueError,
        struct.error, msgspec.MsgspecError, MemoryError,
    )  # fmt: skip


def _metadata(data: bytes) -> Iterator[dict[str, str]]:
    """Yield the metadata records of this project in a file."""
    from mcap.records import Metadata
    from mcap.stream_reader import StreamReader

    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(record, Metadata) and record.name == METADATA:
            yield dict(record.metadata)


def _messages(data: bytes) -> Iterator[bytes]:
    """Yield the ticks of a file, including messages of undeclared channels."""
    from mcap.records import Channel, Chunk, Message
    from mcap.stream_reader import StreamReader, breakup_chunk

    # From memory, a damaged length cannot read more than the rest of the file.
    stream = io.BytesIO(data)
    others: set[int] = set()
    for record in StreamReader(stream, validate_crcs=True, emit_chunks=True).records:
        in_chunk = isinstance(record, Chunk)
        parts = breakup_chunk(_opened(record), validate_crc=True) if in_chunk else (record,)
        for part in parts:
            if isinstance(part, Channel) and part.topic != TOPIC:
                others.add(part.id)
            elif isinstance(part, Message) and part.channel_id not in others:
                yield part.data


def _opened(chunk: Any) -> Any:
    """Decompress a chunk, at most to its declared size, which is bounded."""
    import lz4.frame

    size = chunk.uncompressed_size
    if size > MOST_CHUNK_BYTES or chunk.compression not in ("lz4", "zstd"):
        if chunk.compression == "" and len(chunk.data) <= MOST_CHUNK_BYTES:
            return chunk
        raise ValueError("a chunk is too large, or is compressed otherwise")
    if chunk.compression == "lz4":
        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            content = reader.read(size + 1)
    if len(content) != size:
        raise ValueError("a chunk does not have the size that it declares")
    return dataclasses.replace(chunk, data=content, compression="")


SLOTS_KEY: Final = "slots"
"""Key of the requested number of slots in the metadata of a log."""
OUTSIDE: Final = "outside"
"""Name of the motion in logs and trials if another program sent the goals."""

T = TypeVar("T")


class LoggedMotion(msgspec.Struct, frozen=True):
    """Motion of a run: of a plan, or the table `[motion]` of its robot.toml."""

    motion: str | None = None  # Name, in the log of a plan
    kind: str | None = None  # Kind, in the log of a configured motion
    period_s: float | None = None  # Conditions; None if unknown
    amplitude_rad: float | None = None
    phase_2_rad: float | None = None
    design: Any = None  # Fourier series, which releases up to 0.3 could run instead


class _LoggedConfig(msgspec.Struct, frozen=True):
    """Part of a run's robot.toml that readers use."""

    motion: LoggedMotion = LoggedMotion()
    payload_kg: float | None = None


class LoggedRun(msgspec.Struct, frozen=True):
    period_s: float | None
    payload_kg: float | None  # Mass at the tip, from the metadata
    assumed_payload_kg: float | None  # Mass that the estimator assumed, from robot.toml
    motion: LoggedMotion
    # Whether a probing motion preceded the run, which may have set the observer's payload
    probed: bool = False
    # Requested number of slots; None if the log does not contain it
    slots: int | None = None


def logged_run(log: Recording) -> LoggedRun:
    config = _decoded(log, "config", "{}", _LoggedConfig)
    period_s = _decoded(log, "period_s", "null", float | None)  # type: ignore[arg-type]
    if period_s is not None and not 1e-3 <= period_s <= 1.0:
        raise _damaged(log, "period_s", f"{period_s} s is outside 0.001 to 1 s")
    payload_kg: float | None = _decoded(log, "payload_kg", "null", float | None)  # type: ignore[arg-type]
    motion = config.motion
    if "motion" in log.metadata:
        motion = _decoded(log, "motion", "{}", LoggedMotion)
    if motion.design is not None:
        motion = LoggedMotion()  # its kind and the rest were not those of the goals
    probed = _decoded(log, "probed", "false", bool)
    slots: int | None = _decoded(log, SLOTS_KEY, "null", int | None)  # type: ignore[arg-type]
    return LoggedRun(period_s, payload_kg, config.payload_kg, motion, probed, slots)


def _decoded(log: Recording, key: str, absent: str, kind: type[T]) -> T:
    try:
        value = msgspec.json.decode(log.metadata.get(key, absent), type=kind)
    except (ValueError, RecursionError) as error:
        raise _damaged(log, key, str(error)) from None
    if isinstance(value, float) and not math.isfinite(value):
        raise _damaged(log, key, f"it is {value}")
    return value


def _damaged(log: Recording, key: str, what: str) -> InputError:
    return InputError(log.path, f"its metadata are damaged: {key} ({what})", "record it again")
