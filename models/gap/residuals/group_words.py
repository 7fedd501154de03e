"""Groups of trials in words, from the keys that documents use."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable
from typing import Final

from firmware_py.display_units import DURATION, TIME, symbol_of
from firmware_py.signals import unit_of, without_unit

__all__ = ["groups_in_words", "motion_in_words"]

_KEY: Final = re.compile(
    r"(?P<dof>\d+)dof (?P<motion>.+?) (?P<amplitude>[-+.\de]+)rad (?P<period>[-+.\de]+)s "
    r"(?P<phase>[-+.\de]+)rad( (?P<rows>\d+)x(?P<step>[-+.\de]+)s)?(?P<conditions>( \S+=\S+)*)"
)
"""Form of `models.plant.identification.noise_floor.trial_group_key`; length and step may lack."""
_COUNTS: Final = {1: "one joint", 2: "two joints"}


def motion_in_words(key: str) -> str:
    """Motion and conditions of a group of trials; the key itself if it has another form."""
    found = _KEY.fullmatch(key)
    if found is None:
        return key
    amplitude, phase = (round(math.degrees(float(found[n])), 1) for n in ("amplitude", "phase"))
    dof, period_s = int(found["dof"]), float(found["period"])
    parts = [
        found["motion"].replace("_", " ") + (f" of ±{amplitude:g}°" if amplitude else ""),
        f"period {period_s:g} {TIME.name}" if period_s else "",
        f"joint 2 leads by {phase:g}°" if phase else "",
        _COUNTS.get(dof, f"{dof} joints"),
        *(_condition(text) for text in found["conditions"].split()),
    ]
    return ", ".join(filter(None, parts))


def groups_in_words(keys: Iterable[str]) -> str:
    """Groups of trials in words, with their length where two would read the same."""
    words = {key: motion_in_words(key) for key in keys}
    times = Counter(words.values())
    return "; ".join(
        said + (_length(key) if times[said] > 1 else "") for key, said in words.items()
    )


def _condition(text: str) -> str:
    """Condition such as "load_mass_kg=0.5" as "load mass 0.5 kg"."""
    name, _, value = text.partition("=")
    return f"{without_unit(name)} {value} {symbol_of(unit_of(name) or '1')}".rstrip()


def _length(key: str) -> str:
    found = _KEY.fullmatch(key)
    if found is None or found["rows"] is None:
        return ""
    return f", {found['rows']} rows of {DURATION.text(float(found['step']))}"
