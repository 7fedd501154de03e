"""An improved plant tells every trial it was fitted to, so that none of them passes as unseen."""

from dataclasses import replace

import msgspec
import pytest

from firmware_py.core.errors import InputError
from models.bundle.train import refuse_fitted
from models.gap.diagnosis import diagnose
from models.plant.document import Provenance
from models.plant.plant import read_plant
from models.trials.trial import TrialSet


@pytest.fixture(scope="module")
def parents_trials(trials_of):
    return trials_of(read_plant(), 11, payloads=(1.0,), repeats=1)


@pytest.fixture(scope="module")
def own_trials(trials_of):
    stiffer = read_plant().with_values({"viscous_friction_1_nm_s_rad": 8.0})
    return trials_of(stiffer, 12, payloads=(1.0,), repeats=1)


@pytest.fixture(scope="module")
def improved(plant, parents_trials, own_trials):
    fitted = Provenance(fitted_trials=Provenance().fitted_with(parents_trials))
    known = replace(
        plant,
        provenance=msgspec.structs.replace(plant.provenance, fitted_trials=fitted.fitted_trials),
    )
    others = [name for name in plant.applicable() if name != "viscous_friction"]
    found = diagnose(known, own_trials, leave_out=others)
    assert found.improved.parameters != plant.parameters
    return found.improved


@pytest.mark.parametrize("whose", ["parents_trials", "own_trials"])
def test_a_trial_that_the_plant_or_its_parent_was_fitted_to_is_no_unseen_one(
    request, improved, whose, tmp_path
):
    improved.write(tmp_path / "plant.json")
    provenance = read_plant(tmp_path / "plant.json").provenance
    trial = request.getfixturevalue(whose)[0]
    renamed = TrialSet((replace(trial, name="another_name"),))
    with pytest.raises(InputError, match="another_name"):
        refuse_fitted(provenance, "plant.json", {"unseen_20deg": renamed})


def test_a_trial_that_nothing_was_fitted_to_passes(improved, trials_of):
    fresh = trials_of(read_plant(), 13, payloads=(0.5,), repeats=1)
    refuse_fitted(improved.provenance, "plant.json", {"unseen_20deg": fresh})
