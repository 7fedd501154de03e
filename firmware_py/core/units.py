"""Display units: the units in which values are shown on pages, in figures and on consoles.

Values are stored in SI units everywhere. Code that shows one takes its factor, name and decimals
from here. The FMUs declare `VALUE_UNITS` as FMI display units.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.core.signals import unit_of


class DisplayUnit(NamedTuple):
    """Unit in which a value is shown: shown = factor * value."""

    name: str  # Text after the number; "" for none
    factor: float  # From the SI unit, or from the unit that a constant's text names
    decimals: int  # Decimals in tables and sentences

    def shown(self, values: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(values, dtype=np.float64) * self.factor

    def number(self, value: SupportsFloat, decimals: int | None = None) -> str:
        """Return the number without its unit, with the usual or other decimals."""
        return f"{self.factor * float(value):.{self.decimals if decimals is None else decimals}f}"

    def text(self, value: SupportsFloat, decimals: int | None = None) -> str:
        """Return the number with its unit after a no-break space."""
        return _joined(self.number(value, decimals), self.name)

    def significant(self, value: SupportsFloat, digits: int = 3) -> str:
        """Return the number with its unit, rounded to significant digits."""
        return _joined(f"{self.factor * float(value):.{digits}g}", self.name)

    def label(self, quantity: str) -> str:
        """Return the label of an axis or column, like "tip x in mm"."""
        return f"{quantity} in {self.name}" if self.name else quantity


LENGTH: Final = DisplayUnit("mm", 1e3, 1)
POSITION: Final = DisplayUnit("m", 1.0, 2)
"""For paths and poses in space."""
ANGLE: Final = DisplayUnit("deg", math.degrees(1.0), 1)
ANGULAR_RATE: Final = DisplayUnit("deg/s", math.degrees(1.0), 1)
ANGLE_ERROR: Final = DisplayUnit("mrad", 1e3, 1)
FRACTION: Final = DisplayUnit("%", 1e2, 0)
DEFORMATION: Final = DisplayUnit("%", 1e2, 2)
"""For the Deformation Index."""
CURRENT: Final = DisplayUnit("A", 1.0, 2)
SMALL_CURRENT: Final = DisplayUnit("mA", 1e3, 1)
PAYLOAD: Final = DisplayUnit("kg", 1.0, 1)
PRESSURE: Final = DisplayUnit("kPa", 1e-3, 1)
"""For the link's gauge pressure."""
TIME: Final = DisplayUnit("s", 1.0, 1)
DURATION: Final = DisplayUnit("ms", 1e3, 1)
"""For durations in seconds, such as a period or a timeout."""
DELAY: Final = DisplayUnit("µs", 1e6, 0)
"""For short durations in seconds, such as a servo's return delay."""
TICK_TIME: Final = DisplayUnit("ms", 1e-6, 3)
"""For durations in nanoseconds, in which ticks are timed."""
CPU_TIME: Final = DisplayUnit("µs", 1e-3, 0)
"""For computing times in nanoseconds."""
FILE_SIZE: Final = DisplayUnit("kB", 1e-3, 0)
"""For sizes in bytes."""
DATA_SIZE: Final = DisplayUnit("MB", 1e-6, 0)
"""For limits of readers in bytes."""
BAUD_RATE: Final = DisplayUnit("Mbaud", 1e-6, 0)
"""For baud rates in bits per second."""

VALUE_UNITS: Final = {"rad": ANGLE, "rad/s": ANGULAR_RATE, "m": LENGTH}
"""Display unit of a value by its SI unit; other units are not converted."""
ERROR_UNITS: Final = {"rad": ANGLE_ERROR, "m": LENGTH, "1": FRACTION}
"""Display unit of an error, a small difference of two values, by its SI unit."""

_EXPONENTS: Final = str.maketrans({"2": "²", "3": "³", ".": "·"})


def symbol_of(unit: str) -> str:
    """Return the usual spelling of a unit: "N·m²" for "N.m2", nothing for "1"."""
    return "" if unit == "1" else unit.translate(_EXPONENTS)


def value_unit(unit: str) -> DisplayUnit:
    return VALUE_UNITS.get(unit, DisplayUnit(symbol_of(unit), 1.0, 3))


def si_unit(unit: str) -> DisplayUnit:
    """Return the SI unit itself, in which the figures of the library show a value."""
    return DisplayUnit(symbol_of(unit), 1.0, 3)


def error_unit(unit: str) -> DisplayUnit:
    return ERROR_UNITS.get(unit, DisplayUnit(symbol_of(unit), 1.0, 3))


def signal_unit(name: str) -> DisplayUnit:
    """Return the display unit of a signal by its name: "di", or one that ends in its SI unit."""
    return DEFORMATION if name == "di" else value_unit(unit_of(name) or "1")


def signal_words(name: str) -> str:
    """Return a signal's name without its unit: "tip x" for "tip_x_m", "DI" for "di"."""
    if name == "di":
        return "DI"
    return (name.rsplit("_", 1)[0] if unit_of(name) else name).replace("_", " ")


def _joined(number: str, name: str) -> str:
    return f"{number}\u00a0{name}" if name else number
