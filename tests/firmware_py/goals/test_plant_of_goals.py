"""Plans and maps of another plant: told where the link is the same, refused where it is not."""

import msgspec
import pytest

from firmware_py.core.errors import InputError
from firmware_py.goals.for_robot import note_on_plant
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import NoEstimator
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.link.link_facts import STUDY_FACTS
from models.plant.plant import read_plant
from tests.firmware_py.goals.small_plan import OTHER_PLANT
from tests.firmware_py.simulated_loop import StillPredictor

OWN, OTHER = "1" * 64, "0" * 64


@pytest.fixture
def bundle(bare_bundle, tmp_path):
    """Bundle that was trained with a plant, which lies in it."""
    read_plant().write(tmp_path / "plant.json")
    manifest = msgspec.structs.replace(read_bundle_files(bare_bundle).manifest, plant_sha256=OWN)
    return ModelBundle(tmp_path, manifest, NoEstimator(), StillPredictor())


def made_with(sha256, **facts):
    return sha256, msgspec.structs.replace(STUDY_FACTS, **facts)


def test_another_plant_of_the_same_link_is_told(bundle):
    note = note_on_plant("map.json", *made_with(OTHER), bundle)
    assert note.startswith(f"map.json {OTHER_PLANT} {bundle.directory} (plant_sha256): ")


@pytest.mark.parametrize(
    ("name", "value"),
    [("length_m", 0.6), ("servo", "XM430-W350"), ("gravity_m_s2", (-9.81, 0.0, 0.0))],
)
def test_another_link_is_refused(bundle, name, value):
    with pytest.raises(InputError, match=f"map.json: was made for another link .*: {name} "):
        note_on_plant("map.json", *made_with(OTHER, **{name: value}), bundle)


def test_the_bundles_own_plant_is_taken_without_a_word(bundle):
    assert note_on_plant("map.json", *made_with(OWN), bundle) == ""


def test_a_bundle_without_a_plant_is_judged_by_its_hash_alone(bundle):
    (bundle.directory / "plant.json").unlink()
    assert OTHER_PLANT in note_on_plant("map.json", *made_with(OTHER, length_m=0.6), bundle)
