"""Plant of a bundle, compared with the plant that goals for its robot are made with."""

from __future__ import annotations

import sys
from pathlib import Path

from firmware_py.core.errors import InputError
from firmware_py.inference.manifest import PLANT, BundleFiles
from firmware_py.link.link_facts import facts_of_plant, other_link
from models.plant.document import plain_plant
from models.plant.plant import Plant


def compare_with_bundle(plant: Plant, path: Path | str, files: BundleFiles, product: str) -> None:
    """Compare a plant with that of a bundle; warn on stderr if they differ, refuse another link.

    A bundle without the observer holds no plant, so only the hashes are compared. `product`: what
    is made with the plant, as in "this plan".
    """
    theirs = files.manifest.plant_sha256
    if not theirs or theirs == plant.for_robot().sha256():
        return
    link = facts_of_plant(plain_plant(plant.document()))
    bundle_link = facts_of_plant(files.plant())
    if link and bundle_link and (fact := other_link(link, bundle_link)):
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
