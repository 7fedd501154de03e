"""Plant that goals were made with, compared with that of the robot's bundle."""

from __future__ import annotations

from typing import Final, Protocol

from firmware_py.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import LinkFacts, facts_of_bundle, other_link

__all__ = ["MadeWithPlant", "note_on_plant"]

GOALS_NOTE: Final = "goals_note"
"""Key of the sentence among the facts of a log."""


class MadeWithPlant(Protocol):
    """A plan or a map of goals.

    Attributes
    ----------
    plant_sha256 : str
        Hash of the plant.
    link : LinkFacts or None
        Facts of its link; None in files of earlier versions.
    """

    @property
    def plant_sha256(self) -> str:
        """Hash of the plant."""
        ...

    @property
    def link(self) -> LinkFacts | None:
        """Facts of its link."""
        ...


def note_on_plant(where: str, made: MadeWithPlant, bundle: ModelBundle) -> str:
    """Return a sentence where goals were made with another plant of the same link, or "".

    Files of earlier versions do not tell their link, and their hash is that of the plant with its
    noise floor, which the manifest's is not: they are taken as before. A bundle without the
    observer holds no plant, so that its link is not known; then the sentence is all.

    Parameters
    ----------
    where : str
        Plan or map, for the message.
    made : MadeWithPlant
        The plan or the map.
    bundle : ModelBundle
        The robot's bundle.

    Raises
    ------
    InputError
        If the plant is of another link.
    """
    theirs = bundle.manifest.plant_sha256
    if made.link is None or not theirs or made.plant_sha256 == theirs:
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
