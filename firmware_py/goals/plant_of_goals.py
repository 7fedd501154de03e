"""Comparison of the plant that goals were made with and that of the robot's bundle."""

from __future__ import annotations

from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import LinkFacts, facts_of_bundle, other_link

__all__ = ["note_on_plant"]

GOALS_NOTE: Final = "goals_note"
"""Key of the sentence in the metadata of a log."""


def note_on_plant(where: str, plant_sha256: str, link: LinkFacts, bundle: ModelBundle) -> str:
    """Return a sentence if goals were made with another plant of the same link, or "".

    Goals of another link are refused. A bundle without a plant does not describe its link, so only
    the sentence is returned.
    """
    theirs = bundle.manifest.plant_sha256
    if not theirs or plant_sha256 == theirs:
        return ""
    own = facts_of_bundle(bundle.directory)
    if own is not None and (fact := other_link(link, own)):
        raise InputError(
            where, f"was made for another link than that of {bundle.directory}: {fact}",
            "make it again with the plant of this link",
        )  # fmt: skip
    return (
        f"{where} was made with another plant than the bundle {bundle.directory} (plant_sha256): "
        "its goals and the robot's prediction may differ; train the bundle again with this plant "
        "for the best accuracy"
    )
