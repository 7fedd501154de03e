"""Another size, marker layout, mounting and servo on the rig, and the plant that starts from it."""

import math

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from firmware_py.link.link_description import LinkDescription, LinkGravity, LinkServo
from firmware_py.link.marker_layout import square_layout
from models.commands.new import link_toml
from models.plant.identification.doubts import refuse_other_links
from models.plant.identification.evaluation import evaluate_plant
from models.plant.plant import read_plant
from models.rig.drawn import rig_named
from models.rig.protocol import TrialCase, run_case
from models.trials.checks.trials import check_trial
from models.trials.checks.verdict import ImportVerdict
from models.trials.deformation import deformation_index
from models.trials.files import read_trial, write_trial
from models.trials.pipeline import Inspection
from models.trials.recordings.mapping import MocapFrame, Take, read_mapping
from models.trials.trial import TrialSet
from tests.models.made_trials import with_conditions

LINK = LinkDescription(
    length_m=0.6, width_m=0.1, pressure_pa=20_700.0, payload_kg=0.2, joints=1,
    markers=square_layout(0.6, 0.1, rows=3), servo=LinkServo(model="XM430-W350"),
    gravity=LinkGravity(mounting="hanging"),
)  # fmt: skip


@pytest.fixture(scope="module")
def link_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("link") / "link.toml"
    path.write_text(link_toml(LINK, 0.4, 0.1), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def trial(link_file):
    rig = rig_named(str(link_file)).changed(**{"world.pause_s": 0.3, "world.settle_s": 0.3})
    motion = Motion(dof=1, amplitude_rad=math.radians(30), period_s=2.0)
    case = TrialCase(motion, 0.2, trial=1, pressure_pa=LINK.pressure_pa, gravity=LINK.gravity.unit)
    trial = run_case(rig, case)
    return read_trial(write_trial(trial, link_file.parent))


def test_a_trial_of_the_link_has_its_markers_and_its_weight(trial):
    assert trial.markers_m.shape[1:] == (12, 3) and trial.meta.gravity == (0.0, 0.0, 9.81)
    rest_m = trial.marker_rows_m[: trial.meta.rest_samples].mean(axis=(0, 2))
    np.testing.assert_allclose(rest_m[:, 2], [0.26, 0.46, 0.66], atol=2e-3)
    assert np.nanmax(deformation_index(trial)) > 1e-3
    assert check_trial(trial).refused == []


def test_the_plant_of_the_file_is_near_before_any_fit(trial, link_file):
    error = evaluate_plant(read_plant(link_file), TrialSet((trial,)))
    assert error.tip_rms_m < 0.9 * error.rigid_tip_rms_m  # a stiff link: 5 mm off a rigid one


def test_a_plant_of_another_mounting_is_refused(trial, link_file):
    upright = with_conditions(trial, gravity_m_s2=None)
    refuse_other_links(read_plant(link_file), link_file, (trial,))
    with pytest.raises(InputError, match=r"gravity_m_s2 is \[0, 0, -9.81\]"):
        refuse_other_links(read_plant(link_file), link_file, (upright,))


def test_an_unstable_simulation_is_no_folding_link(link_file, tmp_path, monkeypatch):
    """A rotor of a millionth of its inertia is too light for steps of 1 ms."""
    light = rig_named(str(link_file)).changed(**{"servo.inertia_kg_m2": 5e-8})
    motion = Motion(dof=1, amplitude_rad=0.3, period_s=1.0)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="the simulation is unstable"):
        run_case(light, TrialCase(motion, 0.0, trial=1, gravity=LINK.gravity.unit))
    assert not list(tmp_path.iterdir()), "MuJoCo wrote a log"


def test_a_hanging_link_is_imported_from_a_capture_with_z_up(trial, link_file):
    """In the capture the link points down; size and markers follow from the link that is named."""
    names = trial.meta.layout.names
    columns = dict(trial.columns)
    for name in (*names, "tip"):
        for axis in "yz":
            columns[f"{name}_{axis}_m"] = -columns[f"{name}_{axis}_m"]
    folder = link_file.parent / "capture"
    folder.mkdir()
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "take.csv", table, delimiter=",", header=",".join(columns), comments="")
    conditions = (
        f'dof = 1\npayload_kg = 0.2\ntrial = 1\nmotion = "sinusoid"\nperiod_s = 2.0\n'
        f"amplitude_rad = {math.radians(30)}\n"
    )
    sources = "".join(f'{name} = {{ from = "{name}" }}\n' for name in columns)
    (folder / "map.toml").write_text(
        f'link = "../link.toml"\n[trial]\n{conditions}[frame]\nup = "-z"\n[columns]\n{sources}'
    )
    mapping = read_mapping(folder / "map.toml")
    verdict = ImportVerdict("take")
    imported = Inspection(Take(folder / "take.csv", mapping), "table", verdict).trial()
    assert verdict.refused == [] and imported.meta.gravity == trial.meta.gravity
    np.testing.assert_allclose(imported.markers_m, trial.markers_m, atol=1e-9)
    with pytest.raises(InputError, match="-z-up"):
        upright = msgspec.structs.replace(mapping, frame=MocapFrame())
        Inspection(Take(folder / "take.csv", upright), "table", ImportVerdict("take")).trial()
