"""Range of the time step of a recording of the link: beyond it the times have another unit."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from firmware_py.errors import InputError

STEP_RANGE_S: Final = (5e-5, 0.5)
"""Shortest and longest step: the motion is below 4 Hz, and the fastest analog channels have some
kilohertz."""


def check_step_range(where: Path | str, field: str, step_s: float) -> None:
    """Refuse a step that no recording of the link has.

    Parameters
    ----------
    where : Path or str
        File, for the message.
    field : str
        Column or key that gives the step.
    step_s : float
        Time from one row to the next.

    Raises
    ------
    InputError
        If it is beyond `STEP_RANGE_S`.

    Examples
    --------
    >>> check_step_range("run.csv", "time_s", 0.017)
    """
    low_s, high_s = STEP_RANGE_S
    if low_s <= step_s <= high_s:
        return
    unit = "milliseconds" if step_s > high_s else "another unit"
    raise InputError(
        where, f"{field}: the rows are {step_s:.3g} s apart, outside 0.05 ms to 0.5 s",
        f"give it in s, not in {unit}",
    )  # fmt: skip
