"""Plant of a bundle, compared with the plant that goals for its robot are made with."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec

from firmware_py.errors import InputError
from firmware_py.goals.outside.goal_map import GoalMap
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.manifest import BundleFiles, Manifest
from firmware_py.link.link_facts import PLANT, LinkFacts, facts_of_plant, other_link
from models.plant.plant import Plant
from models.plant.plant_document import plain_plant

__all__ = ["NamedPlant", "plant_for_bundle", "sha256_in_manifest"]

Made = TypeVar("Made", GoalMap, TipPlan)


class NamedPlant(NamedTuple):
    """What a plan or a map tells of its plant, for the robot to compare with its bundle.

    Attributes
    ----------
    sha256 : str
        Hash of the plant, as the manifest of a bundle has it.
    link : LinkFacts or None
        Facts of its link.
    """

    sha256: str
    link: LinkFacts | None

    def in_document(self, made: Made) -> Made:
        """Plan or map that names the plant.

        Parameters
        ----------
        made : GoalMap or TipPlan
            Made with the plant.
        """
        return msgspec.structs.replace(made, plant_sha256=self.sha256, link=self.link)


def sha256_in_manifest(plant: Plant, manifest: Manifest) -> str:
    """Hash of a plant as the manifest of a bundle has it.

    Parameters
    ----------
    plant : Plant
        The plant.
    manifest : Manifest
        Of the bundle; in bundles of earlier versions the hash is that of the whole plant.
    """
    whole = plant.sha256()
    return whole if whole == manifest.plant_sha256 else plant.for_robot().sha256()


def plant_for_bundle(plant: Plant, path: Path, files: BundleFiles, product: str) -> NamedPlant:
    """Compare a plant with that of a bundle; tell on stderr where they differ.

    Parameters
    ----------
    plant : Plant
        The plant.
    path : Path
        Its file.
    files : BundleFiles
        The bundle; without the observer it holds no plant, so that only the hashes are compared.
    product : str
        What is made with the plant, as in "this plan".

    Raises
    ------
    InputError
        If the plant is of another link than the bundle's.
    """
    own = facts_of_plant(plain_plant(plant.document()))
    sha256, theirs = sha256_in_manifest(plant, files.manifest), files.manifest.plant_sha256
    if not theirs or sha256 == theirs:
        return NamedPlant(sha256, own)
    there = _facts_in(files)
    if own is not None and there is not None and (fact := other_link(own, there)):
        raise InputError(
            path, f"is a plant of another link than {files.directory / PLANT}: {fact}",
            "name a plant of the bundle's link, or the bundle of this link",
        )  # fmt: skip
    print(
        f"warning: {path} is not the plant that the bundle {files.directory} was trained with "
        f"(plant_sha256 of its manifest): the robot's prediction and {product} may differ; train "
        "the bundle again with this plant for the best accuracy",
        file=sys.stderr,
    )
    return NamedPlant(sha256, own)


def _facts_in(files: BundleFiles) -> LinkFacts | None:
    if PLANT not in files.contents:
        return None
    try:
        return facts_of_plant(msgspec.json.decode(files.contents[PLANT].data, type=dict))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
