"""Notice at the head of a page: whether its trials are simulated or measured, and of which rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from models.shared.page_parts import Notice
from models.trials.trial_origin import OriginKind, TrialOrigin, kind_of_origins, merged_origins

__all__ = ["KIND_WORDS", "origin_notice"]

KIND_WORDS: Final[dict[OriginKind, str]] = {
    "simulated": "Simulated", "measured": "Measured", "mixed": "Simulated and measured",
    "unknown": "Origin not stated",
}  # fmt: skip
"""Label of a notice and, in lower case, of a badge."""

_ADDED: Final[dict[OriginKind, str]] = {
    "simulated": " No robot was measured.",
    "measured": "",
    "mixed": " Every table and badge says which it is of.",
    "unknown": " Do not take them for measurements.",
}  # fmt: skip


def origin_notice(origins: Sequence[TrialOrigin]) -> Notice:
    """Notice about the origins of everything that a page shows."""
    kind = kind_of_origins(origins)
    listed = [origin.words for origin in merged_origins(origins)]
    joined = " and ".join(filter(None, (", ".join(listed[:-1]), listed[-1])))
    return Notice(kind, KIND_WORDS[kind], f"This page shows {joined}.{_ADDED[kind]}")
