"""Recorded run of the control loop: measurements and goals of each tick, and their file."""

from __future__ import annotations

import io
import lzma
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.config import RobotConfig
from firmware_py.core.errors import InputError

__all__ = ["RunTape", "TapeFacts", "read_runs", "write_runs"]

Columns = Mapping[str, NDArray[Any]]
_FACTS: Final = "facts"
_MEASURED: Final = ("current_", "di", "predicted_")
"""Columns stored with 32 bits, which is enough: the loop only compares them with limits."""
_REMEDY: Final = "record the runs again with 'python -m hil.faults.recorded.run_recorder'"


class TapeFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration, outcome and events of a recorded run; its ticks are stored apart."""

    name: str  # Name of the case in the campaign
    config: RobotConfig
    number: int  # Model number of the servos
    through_pulse: int | None  # Goal in pulses of a motion other than the configured one
    slots: int
    connected_rad: list[list[float]]  # Angles at each connection of the servos
    torque: list[tuple[int, int]]  # Status and alert bits after each switch of the torque
    requested: str  # Reason for a requested stop; empty if none was requested
    ended: str
    reason: str
    ticks: int  # Number of rows


@dataclass(frozen=True)
class RunTape:
    """One recorded run."""

    facts: TapeFacts
    columns: Columns  # Ticks by column, see `column_names`


def column_names(dof: int) -> tuple[str, ...]:
    """Return the columns of a run: a part of the log's, and the statuses of reads and writes."""
    joints = [f"{n}_{j}_{u}" for j in range(1, dof + 1)
              for n, u in (("goal", "rad"), ("angle", "rad"), ("current", "a"))]  # fmt: skip
    return (
        "tick", *joints, "di", "predicted_tip_x_m", "predicted_tip_y_m", "predicted_tip_z_m",
        "state", "lateness_ns", "read_ns", "estimate_ns", "predict_ns", "command_ns", "check_ns",
        "write_ns", "busy_ns", "read_status", "write_status", "read_alert",
    )  # fmt: skip


def write_runs(path: Path, runs: Sequence[RunTape]) -> None:
    """Write recorded runs, all of the same number of joints.

    Each column holds the ticks of all runs in sequence. Most runs are equal up to their fault, so
    the file compresses well.
    """
    names = column_names(runs[0].facts.config.dof)
    facts = np.frombuffer(msgspec.json.encode([run.facts for run in runs]), np.uint8)
    arrays = {_FACTS: facts}
    for name in names:
        column = np.concatenate([run.columns[name] for run in runs])
        arrays[name] = column.astype(np.float32) if name.startswith(_MEASURED) else column
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    path.write_bytes(lzma.compress(buffer.getvalue(), preset=9))


def read_runs(path: Path) -> list[RunTape]:
    """Read recorded runs."""
    try:
        with np.load(io.BytesIO(lzma.decompress(path.read_bytes())), allow_pickle=False) as file:
            facts = msgspec.json.decode(file[_FACTS].tobytes(), type=list[TapeFacts])
            columns = {name: file[name] for name in column_names(facts[0].config.dof)}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, lzma.LZMAError,
            msgspec.DecodeError) as error:  # fmt: skip
        raise InputError(path, f"holds no recorded runs ({error})", _REMEDY) from None
    runs, first = [], 0
    for one in facts:
        part = slice(first, first + one.ticks)
        runs.append(RunTape(one, {name: column[part] for name, column in columns.items()}))
        first += one.ticks
    return runs
