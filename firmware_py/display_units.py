"""Display units: the units in which people read SI values, on pages, in figures and on consoles.

Values are kept in SI units everywhere; whatever shows one takes factor, name and decimals from
here. The FMUs declare `VALUE_UNITS` as FMI display units.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.signals import unit_of


class DisplayUnit(NamedTuple):
    r"""A unit in which a value is shown: shown = factor * value."""

    name: str  # As it is printed after the number; "" for none
    factor: float  # From the SI unit (or from nanoseconds or bytes, where a constant says so)
    decimals: int  # Decimals in tables and sentences

    def shown(self, values: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(values, dtype=np.float64) * self.factor

    def number(self, value: SupportsFloat, decimals: int | None = None) -> str:
        """The shown number without its unit, `decimals` in place of the usual ones."""
        return f"{self.factor * float(value):.{self.decimals if decimals is None else decimals}f}"

    def text(self, value: SupportsFloat, decimals: int | None = None) -> str:
        """The shown number with its unit behind a no-break space."""
        return _joined(self.number(value, decimals), self.name)

    def significant(self, value: SupportsFloat, digits: int = 3) -> str:
        """The shown number to so many significant digits, with its unit."""
        return _joined(f"{self.factor * float(value):.{digits}g}", self.name)

    def label(self, quantity: str) -> str:
        """Label of an axis or column: "tip x in mm"; the quantity alone where it has no unit."""
        return f"{quantity} in {self.name}" if self.name else quantity


LENGTH: Final = DisplayUnit("mm", 1e3, 1)
POSITION: Final = DisplayUnit("m", 1.0, 2)
"""Of paths and poses in space."""
ANGLE: Final = DisplayUnit("deg", math.degrees(1.0), 1)
ANGULAR_RATE: Final = DisplayUnit("deg/s", math.degrees(1.0), 1)
ANGLE_ERROR: Final = DisplayUnit("mrad", 1e3, 1)
FRACTION: Final = DisplayUnit("%", 1e2, 0)
DEFORMATION: Final = DisplayUnit("%", 1e2, 2)
"""Of the Deformation Index."""
CURRENT: Final = DisplayUnit("A", 1.0, 2)
SMALL_CURRENT: Final = DisplayUnit("mA", 1e3, 1)
PAYLOAD: Final = DisplayUnit("kg", 1.0, 1)
PRESSURE: Final = DisplayUnit("kPa", 1e-3, 1)
"""Of the link's gauge pressure."""
TIME: Final = DisplayUnit("s", 1.0, 1)
DURATION: Final = DisplayUnit("ms", 1e3, 1)
"""Of durations in seconds: a period, a timeout."""
DELAY: Final = DisplayUnit("µs", 1e6, 0)
"""Of short durations in seconds: a servo's return delay."""
TICK_TIME: Final = DisplayUnit("ms", 1e-6, 3)
"""Of durations in nanoseconds, as ticks are timed."""
CPU_TIME: Final = DisplayUnit("µs", 1e-3, 0)
"""Of short durations in nanoseconds: what a computation takes."""
FILE_SIZE: Final = DisplayUnit("kB", 1e-3, 0)
"""Of sizes in bytes."""
DATA_SIZE: Final = DisplayUnit("MB", 1e-6, 0)
"""Of limits in bytes: what a reader takes."""
LARGE_DATA_SIZE: Final = DisplayUnit("GB", 1e-9, 1)
"""Of sizes in bytes of what a cluster keeps."""
BAUD_RATE: Final = DisplayUnit("Mbaud", 1e-6, 0)
"""Of baud rates in bits per second."""

VALUE_UNITS: Final = {"rad": ANGLE, "rad/s": ANGULAR_RATE, "m": LENGTH}
"""SI unit of a value to the unit in which it is shown; others are shown as they are."""
ERROR_UNITS: Final = {"rad": ANGLE_ERROR, "m": LENGTH, "1": FRACTION}
"""SI unit of an error, a small difference of two values, to the unit in which it is shown."""

_EXPONENTS: Final = str.maketrans({"2": "²", "3": "³", ".": "·"})


def symbol_of(unit: str) -> str:
    """A unit as people write it: "N·m²" for "N.m2", nothing for "1"."""
    return "" if unit == "1" else unit.translate(_EXPONENTS)


def value_unit(unit: str) -> DisplayUnit:
    """Display unit of a value in an SI unit."""
    return VALUE_UNITS.get(unit, DisplayUnit(symbol_of(unit), 1.0, 3))


def error_unit(unit: str) -> DisplayUnit:
    """Display unit of an error in an SI unit."""
    return ERROR_UNITS.get(unit, DisplayUnit(symbol_of(unit), 1.0, 3))


def signal_unit(name: str) -> DisplayUnit:
    """Display unit of a signal, by its name ("di" or one that ends in its SI unit)."""
    return DEFORMATION if name == "di" else value_unit(unit_of(name) or "1")


def signal_words(name: str) -> str:
    """A signal without its unit: "tip x" for "tip_x_m", "DI" for "di"."""
    if name == "di":
        return "DI"
    return (name.rsplit("_", 1)[0] if unit_of(name) else name).replace("_", " ")


def _joined(number: str, name: str) -> str:
    return f"{number}\u00a0{name}" if name else number
