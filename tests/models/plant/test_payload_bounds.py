"""The largest payload of a plant follows from its link: 3 kg of the study's, more of a heavier."""

from argparse import Namespace
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.link.link_description import STUDY_LINK, LinkDescription, LinkServo
from models.commands import linearise
from models.commands.simulate import _cases, _complete_from_link
from models.plan.planning import PAYLOADS_KG, check_grid
from models.plant.identification.doubts import refuse_other_links
from models.plant.parameter import check_payload
from models.plant.plant import read_plant
from models.plant.step_model import names
from models.rig.parameters import rig_of_link
from models.trials.trial import TrialSet

STEP_S, REST, COUNT = 0.017, 20, 220
HEAVY = LinkDescription(length_m=1.0, width_m=0.3, payload_kg=5.0, joints=1)
SMALL = LinkDescription(
    length_m=0.6, width_m=0.1, pressure_pa=20_700.0, payload_kg=0.1, joints=1,
    servo=LinkServo(model="XM430-W350"),
)  # fmt: skip


def bounds(plant, kind):
    """Bounds of every payload of a model, by name."""
    model = plant.step_model(1, kind)
    rows = (*model.inputs, *model.parameters, *model.states, *model.outputs)
    return {
        v.name: (v.minimum, v.maximum)
        for v in rows
        if v.name in ("payload_kg", "payload_known_kg", "payload_prior_kg")
    }


@pytest.mark.parametrize("kind", ["twin", "observer", "driven"])
def test_the_studys_plant_takes_3_kg_and_another_half_as_much_again_as_its_link(plant_of, kind):
    for plant, most_kg in ((read_plant(), 3.0), (plant_of(STUDY_LINK), 3.0),
                           (plant_of(HEAVY), 7.5), (plant_of(SMALL), 0.15)):  # fmt: skip
        found = bounds(plant, kind)
        assert "payload_kg" in found
        for name, (low, high) in found.items():
            assert high == pytest.approx(most_kg), name
            assert low == (-1.0 if name == "payload_known_kg" else 0.0)


def test_the_observer_of_a_heavy_link_estimates_what_the_link_carries(plant_of):
    plant = plant_of(HEAVY)
    twin, observer = plant.step_model(1, "twin"), plant.step_model(1, "observer")
    moving_s = STEP_S * np.maximum(np.arange(COUNT) - REST, 0)
    goal_rad = -0.4 * np.sin(2 * np.pi / 3.0 * moving_s)
    measured = twin.simulate(np.column_stack([goal_rad, np.full(COUNT, 5.0)]), STEP_S)[:, :2]
    found = observer.simulate(measured, STEP_S)[-1, names(observer.outputs).index("payload_kg")]
    assert found == pytest.approx(5.0, abs=0.2)


def test_payloads_beyond_the_link_are_refused_and_those_within_are_not(plant_of):
    heavy, small = plant_of(HEAVY), plant_of(SMALL)
    check_payload(7.5, link=HEAVY)
    with pytest.raises(InputError, match=r"--payload-kg: is 7.6 kg; give 0 to 7.5 kg"):
        check_payload(7.6, link=HEAVY)
    with pytest.raises(InputError, match="give 0 to 3 kg"):
        check_payload(3.1)
    check_grid(heavy, (0.0, 5.0))
    with pytest.raises(InputError, match=r"--payloads: is 2 kg; give 0 to 0.15 kg"):
        check_grid(small, PAYLOADS_KG)
    check_grid(small, SMALL.payloads_kg)


def test_the_rig_of_a_link_simulates_what_its_plant_takes(tmp_path):
    rig = rig_of_link(SMALL, tmp_path / "link.toml")
    options = {
        "dof": None, "phase_deg": None, "payloads": None, "pressure_pa": None, "gravity": None,
        "trials": 1, "seed": 0, "workers": 1, "amplitude_deg": 30.0, "period": 2.0,
        "motion": "sinusoid", "out": tmp_path / "trials",
    }  # fmt: skip
    args = Namespace(**options)
    _complete_from_link(args, SMALL)
    assert [case.payload_kg for case in _cases(args, rig)] == list(SMALL.payloads_kg)
    args.payloads = [0.2]
    with pytest.raises(InputError, match=r"choose 0 to 0.15, or raise payload_kg in .*link.toml"):
        _cases(args, rig)


def test_trials_with_more_than_the_link_carries_are_refused(plant_of, make_trial):
    plant = plant_of(msgspec.structs.replace(STUDY_LINK, payload_kg=1.0))
    trial = make_trial(np.zeros(8), payload_kg=2.0)
    with pytest.raises(InputError, match=r"payload of 2 kg, a plant of this link takes 1.5 kg"):
        refuse_other_links(plant, "plant.json", TrialSet((trial,)))
    meta = msgspec.structs.replace(trial.meta, payload_kg=1.5)
    refuse_other_links(plant, "plant.json", TrialSet((replace(trial, meta=meta),)))


def test_the_payload_that_nobody_gives_is_within_the_bounds(plant_of, tmp_path, monkeypatch):
    plant_of(SMALL).write(tmp_path / "plant.json")
    told = []
    monkeypatch.setattr(linearise, "emit", lambda args, data, text: told.append(data))
    args = Namespace(
        plant=tmp_path / "plant.json", out=tmp_path / "linear.json", payload_kg=None, dof=1,
        period=STEP_S, angle_deg=None, at_rest=False,
    )  # fmt: skip
    linearise.run(args)
    assert told[0]["payload_kg"] == 0.05
