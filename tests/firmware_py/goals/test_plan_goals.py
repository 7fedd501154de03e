"""Plans on the robot: interpolation by payload, its rate, limits, documents that are refused."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S, tick_dtype
from firmware_py.goals.for_robot import goals_of_plan, note_on_plant
from firmware_py.goals.plan_goals import (
    PlanGoals,
    check_plan_goals,
    payload_beyond_plan,
    recording_beyond_plan,
)
from firmware_py.goals.tip_plan import read_tip_plan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.estimator import Estimate, NoEstimator
from firmware_py.inference.manifest import read_bundle_files
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.safety.limits import Limits
from firmware_py.safety.states import SafetyState
from firmware_py.safety.supervisor import SafetySupervisor
from firmware_py.summary import Ended, RunSummary
from firmware_py.system.timing import Timing
from models.plant.document import plain_plant
from models.plant.plant import read_plant
from tests.firmware_py.goals.small_plan import (
    OTHER_PLANT,
    ROWS,
    column,
    payload_plan,
    plan_of,
    small_plan,
)
from tests.firmware_py.simulated_loop import StillPredictor


def both_joints(payload_kg, factor):
    return payload_plan(payload_kg, column(0.1 * factor), column(0.1 * factor))


@pytest.fixture
def plan():
    """A plan of two joints for 0, 1 and 2 kg."""
    return plan_of(
        both_joints(0.0, 1.2), both_joints(1.0, 1.0), both_joints(2.0, 0.6),
        start_row=5, end_row=30, drawn=((5, 30),),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("payload_kg", "factor"), [(0.0, 1.2), (0.25, 1.15), (1.5, 0.8), (2.0, 0.6)]
)
def test_goals_of_a_known_payload_lie_between_their_neighbours(plan, payload_kg, factor):
    goals = PlanGoals(plan, payload_kg)
    goals.follow(Estimate(0.0, 1.9), 10.0)
    table = np.array([goals.at(slot) for slot in range(ROWS)])
    assert table[:, 0] == pytest.approx(np.array(column(0.1 * factor)), abs=1e-12)


def test_the_payload_follows_the_estimate_at_a_limited_rate(plan):
    goals = PlanGoals(plan)
    assert goals.payload_kg == 1.0
    for estimated_kg in (2.0, math.nan, math.inf):
        goals.follow(Estimate(0.0, estimated_kg), 0.1)
        assert goals.payload_kg == pytest.approx(1.05)
    for estimated_kg, end_of_the_grid_kg in ((5.0, 2.0), (-1.0, 0.0)):
        goals.follow(Estimate(0.0, estimated_kg), 60.0)
        assert goals.payload_kg == end_of_the_grid_kg


def test_no_estimate_brings_a_checked_plan_beyond_a_limit(plan):
    """The worst that an estimate can do: jump between the ends of the grid at any time."""
    limits = Limits(rate_rad_s=2.0)
    check_plan_goals(plan, limits, "plan")
    rng = np.random.default_rng(1)
    for _ in range(20):
        goals, supervisor = PlanGoals(plan), SafetySupervisor(limits, 2)
        supervisor.arm(goals.at(0))
        supervisor.start()
        for slot in range(ROWS):
            goals.follow(Estimate(0.0, rng.choice([0.0, 2.0])), PERIOD_S)
            supervisor.admit(goals.at(slot))
            assert not supervisor.tripped, supervisor.reason


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        (Limits(angle_rad=(-0.11, 0.11)), r"plan: row \d+ \(.* s\), 0 kg: .* joint 1 is"),
        (Limits(rate_rad_s=0.3), r"row \d+ .*, 0 kg: .* moves at"),
        (Limits(acceleration_rad_s2=3.0), r"row \d+ .* accelerates at"),
    ],
)
def test_goals_beyond_a_limit_are_refused_with_the_row(plan, limits, sentence):
    with pytest.raises(InputError, match=sentence):
        check_plan_goals(plan, limits, "plan")


def test_a_change_of_the_payload_counts_in_the_limits(plan):
    rate = np.max(np.abs(np.diff(column(0.12)))) / PERIOD_S
    limits = Limits(rate_rad_s=float(rate) + 1e-3)
    with pytest.raises(InputError, match="while the estimate of the payload changes"):
        check_plan_goals(plan, limits, "plan")
    alone = msgspec.structs.replace(plan, payloads=plan.payloads[:1])
    check_plan_goals(alone, limits, "plan")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"dof": 3}, "3 joints"),
        ({"dof": 1}, "needs 1 columns"),
        ({"period_s": 0.0}, "period of 0 s"),
        ({"payloads": ()}, "no payload"),
        ({"desired_m": (column(0.1), column(0.1)[:-1])}, "different length"),
        ({"end_row": ROWS + 1}, "outside of its 40 rows"),
        ({"payloads": (both_joints(1.0, 1.0), both_joints(1.0, 1.0))}, "do not rise"),
        ({"payloads": (both_joints(-1.0, 1.0),)}, "negative"),
        ({"payloads": (payload_plan(1.0, column(0.1)[:-1], column(0.1)),)}, "goals_rad|not fit"),
        ({"payloads": (payload_plan(1.0, (math.nan,) * ROWS, column(0.1)),)}, "goals_rad|not fit"),
    ],
)
def test_a_document_that_cannot_be_run_is_refused(plan, tmp_path, change, sentence):
    path = tmp_path / "plan.json"
    write_document(path, plan)
    assert read_tip_plan(path) == plan
    write_document(path, msgspec.structs.replace(plan, **change))
    with pytest.raises(InputError, match=sentence):
        read_tip_plan(path)


# --- payloads beyond the plan -------------------------------------------------------------------


@pytest.fixture
def note(toy_bundle):
    """Note on a run with an estimate for each tick, of a plan from 0 to 1 kg."""

    def note(estimated_kg, known_kg=None, **columns):
        records = np.zeros(100, tick_dtype(1))
        records["tick"], records["state"] = np.arange(100), SafetyState.RUNNING
        records["payload_kg"] = estimated_kg
        for name, values in columns.items():
            records[name] = values
        summary = RunSummary(Ended.FINISHED, "", 100, {}, 0, Timing(), records, 0)
        return payload_beyond_plan(small_plan(toy_bundle), known_kg, summary)

    return note


def test_an_estimate_that_stays_beyond_the_plan_is_reported(note):
    assert all(word in note(1.4) for word in ("1.40 kg", "0 to 1 kg", "for 1 kg", "--payloads"))
    assert "-0.20 kg" in note(-0.2) and "for 0 kg" in note(-0.2)
    for inside_kg in (0.0, 1.0, 1.04, np.nan):
        assert note(inside_kg) == ""
    assert note(1.4, known_kg=1.0) == "", "it was not estimated"


def test_only_what_the_estimate_settles_to_counts(note):
    settling = np.where(np.arange(100) < 45, 1.4, 0.8)
    assert note(settling) == ""
    assert note(settling[::-1]) != ""
    before = np.where(np.arange(100) < 90, -1, 5)  # an approach that outlasts the motion
    assert note(np.where(before < 0, 1.4, 0.8), tick=before) == ""
    assert note(1.4, state=SafetyState.STOPPING) == ""


def test_a_recording_of_a_payload_beyond_the_plan_is_reported(toy_bundle):
    plan = small_plan(toy_bundle)
    note = recording_beyond_plan(plan, 3.0)
    assert all(word in note for word in ("3 kg", "0 to 1 kg", "for 1 kg", "--payloads"))
    assert recording_beyond_plan(plan, 0.4) == "" == recording_beyond_plan(plan, 1.04)
    alone = msgspec.structs.replace(plan, payloads=plan.payloads[1:])
    assert "1 kg alone" in recording_beyond_plan(alone, 0.4)


# --- plans on a robot and its bundle ------------------------------------------------------------


def robot(servos=1, **changes):
    ids = range(1, servos + 1)
    values = {
        "bundle": "b", "bus": BusConfig(port="p"), "payload_kg": 0.5,
        "servos": tuple(ServoConfig(id=k, model="XM430-W350") for k in ids),
    }  # fmt: skip
    return RobotConfig(**values | changes)


def test_a_plan_for_the_robot_and_its_bundle_is_run(toy_bundle):
    bundle = ModelBundle.load(toy_bundle)
    goals = goals_of_plan(small_plan(toy_bundle), robot(), bundle)
    assert goals.source.payload_kg == 0.5 and goals.correction is None


@pytest.mark.parametrize(
    ("plan_changes", "robot_changes", "named"),
    [
        ({}, {"servos": 2}, "joints"),
        ({"period_s": 0.02}, {}, "period"),
        ({"bundle_sha256": "0" * 64}, {}, "another bundle"),
        ({}, {"payload_kg": None}, "payload_kg"),
        ({}, {"limits": Limits(angle_rad=(-0.01, 0.01))}, "angle"),
    ],
    ids=["joints", "period", "bundle", "unknown payload", "limits"],
)
def test_a_plan_that_does_not_suit_the_robot_is_refused(
    toy_bundle, plan_changes, robot_changes, named
):
    bundle = ModelBundle.load(toy_bundle)
    bundle = replace(bundle, manifest=msgspec.structs.replace(bundle.manifest, estimator="none"))
    plan = msgspec.structs.replace(small_plan(toy_bundle), **plan_changes)
    with pytest.raises(InputError, match=named):
        goals_of_plan(plan, robot(**robot_changes), bundle)


# --- plans and maps of another plant ------------------------------------------------------------

SAME, OTHER = "1" * 64, "0" * 64


@pytest.fixture
def bundle(bare_bundle):
    """Bundle that was trained with a plant, which lies in it."""
    manifest = msgspec.structs.replace(read_bundle_files(bare_bundle).manifest, plant_sha256=SAME)
    plant = plain_plant(read_plant().document())
    return ModelBundle(bare_bundle, manifest, NoEstimator(), StillPredictor(), plant=plant)


def test_another_plant_of_the_same_link_is_noted(bundle):
    assert note_on_plant("map.json", SAME, STUDY_FACTS, bundle) == ""
    note = note_on_plant("map.json", OTHER, STUDY_FACTS, bundle)
    assert note.startswith(f"map.json {OTHER_PLANT} {bundle.directory} (plant_sha256): ")


@pytest.mark.parametrize(
    ("name", "value"),
    [("length_m", 0.6), ("servo", "XM430-W350"), ("gravity_m_s2", (-9.81, 0.0, 0.0))],
)
def test_another_link_is_refused(bundle, name, value):
    other = msgspec.structs.replace(STUDY_FACTS, **{name: value})
    with pytest.raises(InputError, match=f"map.json: was made for another link .*: {name} "):
        note_on_plant("map.json", OTHER, other, bundle)
    without = replace(bundle, plant={})  # then the hash alone is compared
    assert OTHER_PLANT in note_on_plant("map.json", OTHER, other, without)
