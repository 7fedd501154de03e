"""What `dropstitch run` says of the inputs of the predictor that were out of range."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.documents import read_document
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.predictor import InputRange
from firmware_py.inference.range_check import RangeCount, RangeWatch
from firmware_py.summary import RunDocument
from tests.firmware_py import test_robot_commands as robot

servos, config, call = robot.servos, robot.config, robot.call


@pytest.fixture
def watch(toy_bundle):
    return RangeWatch(ModelBundle.load(toy_bundle))


def predict(watch, angle_rad=0.1, current_a=0.5, di=0.002):
    return watch.predict(np.array([angle_rad]), np.array([current_a]), di)


def test_each_input_is_named_with_its_extreme_and_its_range(watch, toy_bundle):
    ranges = {q.name: q for q in ModelBundle.load(toy_bundle).manifest.features}
    assert predict(watch).in_range
    for angle_rad, di in ((0.7, 0.002), (0.9, 0.002), (-0.8, 0.3)):
        assert not predict(watch, angle_rad, di=di).in_range
    found = watch.reasons()
    assert [(row.name, row.ticks, row.extreme) for row in found.inputs] == [
        ("angle_1_rad", 3, 0.9), ("di", 1, 0.3),
    ]  # fmt: skip
    for row in found.inputs:
        own = ranges[row.name]
        assert (row.minimum, row.maximum, row.unit) == (own.minimum, own.maximum, own.unit)
    assert found.other_ticks == 0
    note = found.note.replace("\u00a0", " ")
    assert all(word in note for word in ("angle 1", "51.6 deg", "3 of them"))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_is_no_extreme(watch, value):
    assert not predict(watch, di=value).in_range
    predict(watch, angle_rad=0.9)
    found = watch.reasons()
    assert found.other_ticks == 1
    assert [row.extreme for row in found.inputs] == [0.9]
    assert "1 of them" in found.note


def test_the_bounds_of_the_graph_count_and_not_the_training_range(toy_bundle):
    bundle = ModelBundle.load(toy_bundle)
    angle, *others = bundle.ranges
    bounded = msgspec.structs.replace(angle, bounds=(-0.75, 0.75))
    watch = RangeWatch(replace(bundle, ranges=(bounded, *others)))
    predict(watch, angle_rad=0.7)
    predict(watch, angle_rad=0.8)
    found = watch.reasons()
    assert [row.ticks for row in found.inputs] == [1]
    assert found.wide_ticks + found.other_ticks == 1


def test_each_cause_is_counted_apart():
    """An innovation widens the interval only if the joints move; a late sample widens it, too."""
    bend = InputRange("bend_1_rad", -0.1, 0.1, (-0.15, 0.15))
    innovation = InputRange("innovation_1_a", 0.0, 0.1, (None, 0.15))
    count = RangeCount((bend, innovation))
    narrow, wide = np.full(3, 0.004), np.array([0.004, 0.0, 0.023])
    count.add(np.array([0.2, 0.05]), narrow)
    count.add(np.array([0.0, 0.4]), wide)
    count.add(np.array([0.0, 0.01]), wide, age_s=0.034)
    count.add(np.array([0.0, 0.01]), 2 * wide)
    count.add(np.array([0.0, 0.4]), narrow)
    found = count.reasons()
    assert [(row.name, row.ticks, row.extreme) for row in found.inputs] == [
        ("bend_1_rad", 1, 0.2), ("innovation_1_a", 1, 0.4),
    ]  # fmt: skip
    assert (found.wide_ticks, found.late_ticks, found.other_ticks) == (2, 1, 1)
    assert found.widest_m == 0.046
    note = found.note.replace("\u00a0", " ")
    assert all(words in note for words in ("innovation 1 reached 400.0 mA", "±46.0 mm", "late"))


@pytest.mark.slow
def test_the_summary_of_a_run_names_the_input(servos, config, toy_bundle, tmp_path, capsys):
    current_a = 20.0
    config.write_text(config.read_text().replace("[limits]", "[limits]\ncurrent_a = 90.0"))
    servos.put(1, Register.PRESENT_CURRENT, round(current_a / MODELS[54024].current_a_per_lsb))
    code, output = call(capsys, "run", "--config", config)
    assert code == 0, output.err
    (line,) = (line for line in output.out.splitlines() if "training range" in line)
    assert "current 1 reached 19996.6" in line and "mA in" in line and "trained from -" in line
    (path,) = tmp_path.rglob("*.timing.json")
    document = read_document(path, RunDocument)
    beyond = {row.name: row for row in document.out_of_range_reasons.inputs}["current_1_a"]
    assert beyond.ticks == document.out_of_range == document.ticks
    assert beyond.extreme == pytest.approx(current_a, abs=0.1)
    assert beyond.maximum < 19.0
    assert json.loads(path.read_bytes())["out_of_range_reasons"]["inputs"][0]["unit"] == "A"
