"""Mistakes that are easily made in an import are told with their cause, refused or warned of."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.motion import Motion
from models.rig.parameters import read_parameters
from models.rig.protocol import TrialCase, run_case
from models.trials.checks.verdict import ImportVerdict
from models.trials.pipeline import Source, inspect_import
from models.trials.recordings.mapping import read_mapping
from tests.models.trials.recordings.written_takes import WrittenTake


@pytest.fixture(scope="module")
def rig_trials():
    """A trial of one joint and one of both, on the rig."""
    motions = (Motion(), Motion(dof=2, phase_2_rad=math.pi / 2))
    return [run_case(read_parameters(), TrialCase(motion, 1.0, 1, 0)) for motion in motions]


def told(trial, directory, **fields):
    """Findings of an import as (level, cause, text), and the sentence with which it ends."""
    WrittenTake(offset_s=0.7, **fields).write(trial, directory, 1)
    verdict, refusal = ImportVerdict("take"), ""
    source = Source(directory / "take.csv", "motive", directory / "servo.csv")
    try:
        inspect_import(source, read_mapping(directory / "map.toml"), verdict)
    except InputError as error:
        refusal = error.what
    texts = [f.text.replace("\xa0", " ") for f in verdict.findings]
    levels = [(f.level, f.cause) for f in verdict.findings]
    return [(*level, text) for level, text in zip(levels, texts, strict=True)], refusal


def conditions(**stated):
    """Change of a map: other conditions."""
    return lambda document: document["trial"].update(stated)


def columns(**sources):
    """Change of a map: other sources of the servo's columns; without a unit for None."""

    def change(document):
        for name, source in sources.items():
            entry = document["servo_columns"][name]
            entry.pop("unit") if source is None else entry.update(source)

    return change


def signals(**functions):
    """Change of a trial before its log is written: a function of each changed column."""
    return lambda trial: replace(
        trial, columns=trial.columns | {n: f(trial.columns[n]) for n, f in functions.items()}
    )


def one_joint(document):
    document["trial"]["dof"] = 1
    for name in ("goal_2_rad", "angle_2_rad", "current_2_a"):
        document["servo_columns"].pop(name)


COUNTS = {"scale": 4096 / 360 * math.degrees(1)}
TURNS = {"scale": math.degrees(1) / 360}
TWICE = {"scale": math.radians(1)}
BOTH = ("goal_1_rad", "angle_1_rad")

MISTAKES = {
    "angle in deg": (dict(changes=columns(angle_1_rad=None)), "refused", "unit", "in deg"),
    "goal in deg": (dict(changes=columns(goal_1_rad=None)), "refused", "unit", "in deg"),
    "angles in counts": (
        dict(changes=columns(goal_1_rad=COUNTS, angle_1_rad=COUNTS)), "refused", "unit", "counts",
    ),
    "angles in turns": (
        dict(changes=columns(goal_1_rad=TURNS, angle_1_rad=TURNS)), "refused", "gain", "in turns",
    ),
    "converted twice": (
        dict(changes=columns(goal_1_rad=TWICE, angle_1_rad=TWICE)), "refused", "gain", "twice",
    ),
    "current in mA": (dict(changes=columns(current_1_a=None)), "refused", "unit", "mA"),
    "time in ms": (dict(changes=columns(time_s=None)), "refused", "time", "another unit"),
    "markers in mm": (dict(scale=1e3), "refused", "scale", "in mm"),
    "markers in inches, aligned": (
        dict(scale=39.37, align="rest"), "refused", "scale", "in inches",
    ),
    "left-handed": (dict(wrong={"mirror": "x"}), "refused", "swapped", "left-handed"),
    "another link's length": (
        dict(changes=conditions(link_length_m=0.75)), "refused", "scale", "rows of markers",
    ),
    "a length 5 cm off": (
        dict(changes=conditions(link_length_m=1.0)), "refused", "scale", "rows of markers",
    ),
    "another link's width": (
        dict(changes=conditions(link_width_m=0.2), align="rest"), "warning", "scale", "corners",
    ),
    "goals from the angle": (
        dict(changes=columns(goal_1_rad={"from": "pos1"})), "warning", "goal", "both taken from",
    ),
    "goal and angle exchanged": (
        dict(changes=columns(goal_1_rad={"from": "pos1"}, angle_1_rad={"from": "goal1"})),
        "warning", "goal", "before goal_1_rad",
    ),
    "a constant angle": (
        dict(signals=signals(angle_1_rad=np.zeros_like)), "refused", "stuck", "does not change",
    ),
    "a centre of 180 deg": (
        dict(signals=signals(**dict.fromkeys(BOTH, lambda v: v + np.pi))), "refused", "zero",
        "reads 180.0",
    ),
    "an encoder's zero 10 deg off, aligned": (
        dict(signals=signals(**dict.fromkeys(BOTH, lambda v: v + 0.17)), align="rest"),
        "refused", "zero", "zero is elsewhere",
    ),
    "a current without sign": (
        dict(signals=signals(current_1_a=np.abs)), "warning", "current", "never negative",
    ),
    "negative currents read as unsigned": (
        dict(signals=signals(current_1_a=lambda v: np.where(v < 0, v + 65.536, v))),
        "warning", "current", "never negative",
    ),
    "the current's sign": (
        dict(signals=signals(current_1_a=np.negative)), "warning", "current", "sign is turned",
    ),
    "too many rows at rest": (
        dict(changes=conditions(rest_samples=150)), "refused", "rest", "within the 150 rest rows",
    ),
    "another period": (
        dict(changes=conditions(period_s=2.0)), "warning", "period", "period of 2 s",
    ),
    "a log of a smaller motion": (
        dict(signals=signals(**dict.fromkeys(BOTH, lambda v: 0.7 * v))), "refused", "gain", "1.4",
    ),
    "a frame rate of 100 Hz for 120": (dict(rate_hz=100.0), "refused", "rate", "0.833"),
    "a frame rate of 60 Hz for 120": (dict(rate_hz=60.0), "refused", "rate", "by 0.5"),
    "a frame rate of 125 Hz for 120": (dict(rate_hz=125.0), "refused", "rate", "1.04"),
    "a frame rate 1 % off": (dict(rate_hz=119.0), "warning", "clock", "drift apart"),
    "50 g as kg": (dict(changes=conditions(payload_kg=50.0)), "warning", "payload unit", "folds"),
    "base markers on a stand": (dict(base="stand"), "refused", "base", "fixed stand"),
    "base markers on a stand, aligned by them": (
        dict(base="stand", align="base"), "refused", "base", "fixed stand",
    ),
    "base_offset_m by base markers": (
        dict(base="plate", align="base", changes=conditions(base_offset_m=0.10)),
        "refused", "base offset", "0.060 m below the base plate",
    ),
    "base_offset_m by the first row": (
        dict(align="rest", changes=conditions(base_offset_m=0.10)), "warning", "base offset",
        "plate 0.060 m above",
    ),
    "base_offset_m too small": (
        dict(align="rest", changes=conditions(base_offset_m=0.03)), "warning", "base offset",
        "plate 0.060 m above",
    ),
}  # fmt: skip
"""Fields of the written take, and level, cause and words of the finding."""


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_with_its_cause(name, rig_trials, tmp_path):
    fields, level, cause, words = MISTAKES[name]
    found, refusal = told(rig_trials[0], tmp_path, **fields)
    assert any((lv, c) == (level, cause) and words in text for lv, c, text in found), found
    assert bool(refusal) == (level == "refused")
    if refusal:
        first = next(text for lv, _, text in found if lv == "refused")
        assert words in first and refusal.startswith(first)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (dict(changes=one_joint), "moves in two directions"),
        (dict(swap_joints=True), "joints 1 and 2 are swapped"),
        (
            dict(
                changes=columns(current_1_a={"from": "cur2"}, current_2_a={"from": "cur1"})
            ),
            "currents 1 and 2 are swapped",
        ),
        (
            dict(base="plate", align="base", changes=conditions(base_offset_m=0.10)),
            "0.060 m below",
        ),
        (dict(align="rest", changes=conditions(base_offset_m=0.10)), "plate 0.060 m above"),
    ],
)  # fmt: skip
def test_a_mistake_with_two_joints_is_told_with_its_cause(fields, words, rig_trials, tmp_path):
    found, refusal = told(rig_trials[1], tmp_path, **fields)
    assert words in refusal or any(words in text for _, _, text in found), (found, refusal)


@pytest.mark.parametrize("joints", [1, 2])
@pytest.mark.parametrize("align", ["none", "base", "rest"])
def test_base_markers_on_their_plate_are_right(joints, align, rig_trials, tmp_path):
    found, refusal = told(rig_trials[joints - 1], tmp_path, base="plate", align=align)
    assert not refusal and {cause for _, cause, _ in found} <= {"lean"}, found


@pytest.mark.parametrize("first_s", [1.1, 1.4, 2.4])
def test_a_recording_without_its_rest_is_not_blamed_on_frame_rate_or_zero(
    first_s, rig_trials, tmp_path
):
    found, refusal = told(rig_trials[0], tmp_path, first_s=first_s)
    assert refusal and not {"rate", "zero"} & {cause for _, cause, _ in found}
