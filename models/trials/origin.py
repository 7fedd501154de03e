"""Origin of trials: simulated or measured, on which rig, and the notice of it on a page.

It follows from `source` of a trial's conditions; a value that the project does not write is
"unknown". A trial does not state its rig, so that nothing can be tuned to it. The record beside the
trial does (`models.rig.protocol`); only the name of the rig is read from it, as a label.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Literal

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_json
from models.shared.pages import Notice
from models.trials.trial import Trial

OriginKind = Literal["simulated", "measured", "mixed", "unknown"]

CONDITIONS_FILE: Final = "rig_conditions.json"
_SOURCES: Final[dict[str, tuple[OriginKind, str]]] = {
    "rig": ("simulated", "trials of a rig"),
    "sil": ("simulated", "runs of the loop with emulated servos"),
    "simulated": ("simulated", "runs of a simulated plant"),
    "measured": ("measured", "trials of a measured system"),
    "recording": ("measured", "trials from logs of a robot"),
}
"""Kind and words of each source that the project writes."""


class TrialOrigin(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Trials of one origin, and their number."""

    source: str
    rig: str = ""  # Name of the rig; empty for a measured system or without a record
    trials: int = 1

    @property
    def kind(self) -> OriginKind:
        """Whether the trials were simulated or measured."""
        return _SOURCES.get(self.source, ("unknown", ""))[0]

    @property
    def words(self) -> str:
        """Origin in words: "trials of the rig “default”"."""
        if self.source not in _SOURCES:
            named = f" but “{self.source}”" if self.source else ""
            return f"trials that state no origin{named}"
        words = _SOURCES[self.source][1]
        if not self.rig or self.source not in ("rig", "sil"):
            return words
        rig = "the twin" if self.rig == "twin" else f"the rig “{self.rig}”"
        return f"trials of {rig}" if self.source == "rig" else f"{words}, {rig} behind them"

    @property
    def counted(self) -> str:
        """Origin in words with the number of trials."""
        return f"{self.trials} {self.words}"


def origins_of(trials: Iterable[Trial]) -> tuple[TrialOrigin, ...]:
    """Distinct origins of trials, in the order of their first trial."""
    return merged_origins(TrialOrigin(t.meta.source, recorded_rig(t)) for t in trials)


def recorded_rig(trial: Trial) -> str:
    """Name of the rig that a trial ran on, from the record beside its file; empty without one."""
    if trial.meta.source != "rig" or trial.path == Path():
        return ""
    try:
        document = read_json(trial.path.parent / CONDITIONS_FILE, "simulate the trials again")
        return Path(document["trials"][trial.name]["rig"]).name
    except (InputError, LookupError, TypeError):  # missing or damaged
        return ""


def merged_origins(origins: Iterable[TrialOrigin]) -> tuple[TrialOrigin, ...]:
    """Origins merged, with the numbers of equal ones added."""
    counts: Counter[tuple[str, str]] = Counter()
    for origin in origins:
        counts[origin.source, origin.rig] += origin.trials
    return tuple(TrialOrigin(*key, count) for key, count in counts.items())


def kind_of_origins(origins: Iterable[TrialOrigin]) -> OriginKind:
    """Kind of a set of trials: "mixed" if it holds simulated and measured ones.

    Otherwise the kind is "unknown" if the set is empty or holds an unknown origin.
    """
    kinds = {origin.kind for origin in origins}
    if {"simulated", "measured"} <= kinds:
        return "mixed"
    return kinds.pop() if len(kinds) == 1 else "unknown"


KIND_WORDS: Final[dict[OriginKind, str]] = {
    "simulated": "Simulated", "measured": "Measured", "mixed": "Simulated and measured",
    "unknown": "Origin not stated",
}  # fmt: skip
"""Label of a notice and, in lower case, of a badge."""

_ADDED: Final[dict[OriginKind, str]] = {
    "simulated": " No robot was measured.", "measured": "",
    "mixed": " Every table and badge says which it is of.",
    "unknown": " Do not take them for measurements.",
}  # fmt: skip


def origin_notice(origins: Sequence[TrialOrigin]) -> Notice:
    """Notice about the origins of everything that a page shows."""
    kind = kind_of_origins(origins)
    *others, last = [origin.words for origin in merged_origins(origins)]
    joined = f"{', '.join(others)} and {last}" if others else last
    return Notice(kind, KIND_WORDS[kind], f"This page shows {joined}.{_ADDED[kind]}")
