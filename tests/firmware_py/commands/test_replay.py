"""Replay of logs that do not run through: a port that came back, ticks that the log lacks."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from firmware_py.commands.replay import compare, find_seams
from firmware_py.core.signals import PERIOD_S, tip_names
from firmware_py.inference.bundle import ModelBundle
from firmware_py.log.recording import Recording
from firmware_py.safety.states import SafetyState
from firmware_py.tick_log import LONGEST_STEP_SLOTS
from tests.firmware_py.simulated_loop import Steps, StillPredictor
from tests.firmware_py.test_robot import motion, robot_config

COUNT, GONE = 150, 60
"""Ticks, and the first of them after the port had come back."""


def log_of(**changes):
    """Ticks of a motion, 40 slots of which passed while the port was gone."""
    angle_rad, current_a = motion(COUNT)
    slot = np.arange(COUNT)
    slot[GONE:] += 40
    state = np.full(COUNT, int(SafetyState.RUNNING))
    state[GONE - 10 : GONE - 1], state[GONE - 1] = SafetyState.STOPPING, SafetyState.OFF
    columns = {
        "angle_1_rad": angle_rad[:, 0], "current_1_a": current_a[:, 0], "tick": slot,
        "missed": np.zeros(COUNT, int), "state": state, "payload_kg": np.full(COUNT, np.nan),
    } | dict.fromkeys(("di", *tip_names("predicted_")), np.zeros(COUNT))  # fmt: skip
    config = msgspec.json.encode(robot_config()).decode()
    metadata = {"dof": "1", "period_s": str(PERIOD_S), "config": config}
    return Recording(columns | changes, metadata, complete=True)


def test_the_past_before_a_port_that_came_back_is_discarded_as_in_the_run(toy_bundle):
    bundle, log = ModelBundle.load(toy_bundle), log_of()
    di, tips_m = [], []
    for k in range(COUNT):
        if k in (0, GONE):
            bundle.estimator.reset()
        sample = log.columns["angle_1_rad"][k : k + 1], log.columns["current_1_a"][k : k + 1]
        di.append(bundle.estimator.update(*sample, PERIOD_S).di)
        tips_m.append(bundle.predictor.predict(*sample, di[-1]).tip_m)
    answers = {"di": np.array(di)}
    answers |= dict(zip(tip_names("predicted_"), np.transpose(tips_m), strict=True))
    assert set(compare(log_of(**answers), bundle).values()) == {0.0}
    through = log_of(**answers, state=np.full(COUNT, int(SafetyState.RUNNING)))
    assert compare(through, bundle)["di"] > 1e-6, "the past counts"


def test_a_leap_of_the_clock_is_the_step_of_the_loop():
    estimator = Steps()
    missed = np.zeros(COUNT, int)
    missed[70], missed[80] = 4, 10 * LONGEST_STEP_SLOTS
    robot = SimpleNamespace(
        manifest=SimpleNamespace(dof=1), estimator=estimator, predictor=StillPredictor(),
        assume_payload=lambda payload_kg: None,
    )  # fmt: skip
    compare(log_of(missed=missed), robot)
    taken = estimator.steps_s
    assert taken[69:72] == pytest.approx([PERIOD_S, 5 * PERIOD_S, PERIOD_S])
    assert taken[80] == pytest.approx(LONGEST_STEP_SLOTS * PERIOD_S)


def test_ticks_that_a_log_lacks_are_counted_and_slots_that_were_missed_are_not():
    logged = np.delete(np.arange(COUNT), [20, 21, 90])
    log = log_of()
    assert find_seams(log).missing == 0
    lacking = Recording({n: c[logged] for n, c in log.columns.items()}, log.metadata, True)
    assert find_seams(lacking).missing == 3
    missed = np.zeros(COUNT - 3, int)
    missed[20] = 2
    columns = lacking.columns | {"missed": missed}
    assert find_seams(Recording(columns, log.metadata, True)).missing == 1
