"""Plant that goals were made with, compared with that of the robot's bundle."""

from __future__ import annotations

from typing import Final

from firmware_py.errors import InputError
from firmware_py.goals.outside.goal_map import GoalMap
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import facts_of_bundle, other_link

__all__ = ["note_on_plant"]

GOALS_NOTE: Final = "goals_note"
"""Key of the sentence among the facts of a log."""


def note_on_plant(where: str, made: GoalMap | TipPlan, bundle: ModelBundle) -> str:
    """Return a sentence where goals were made with another plant of the same link, or "".

    A bundle without the observer holds no plant, so that its link is not known; then the sentence
    is all.
    """
    theirs = bundle.manifest.plant_sha256
    if not theirs or made.plant_sha256 == theirs:
        return ""
    own = facts_of_bundle(bundle.directory)
    if own is not None and (fact := other_link(made.link, own)):
        raise InputError(
            where, f"was made for another link than that of {bundle.directory}: {fact}",
            "make it again with the plant of this link",
        )  # fmt: skip
    return (
        f"{where} was made with another plant than the bundle {bundle.directory} (plant_sha256): "
        "its goals and the robot's prediction may differ; train the bundle again with this plant "
        "for the best accuracy"
    )
