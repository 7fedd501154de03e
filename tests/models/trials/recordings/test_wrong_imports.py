"""Wrong imports are refused or warned of with their cause; right ones pass with the right clock."""

import functools
import json
import math

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from models.rig.parameters import read_parameters
from models.rig.protocol import TrialCase, run_case
from models.trials.checks.verdict import ImportVerdict
from models.trials.pipeline import Inspection
from models.trials.recordings.mapping import Take, read_mapping
from tests.models.made_trials import with_columns
from tests.models.trials.recordings.written_takes import ORIGIN_M, REST, WrittenTake, rigid_trial


@pytest.fixture(scope="module")
def trials():
    """A rigid link on one joint and on two that move out of phase, and the same on the rig."""
    t = np.clip(0.017 * np.arange(1 - REST, 361), 0, 5.0)
    smooth = np.clip(t, 0, 1) ** 2 * np.clip(5.0 - t, 0, 1) ** 2
    both = np.column_stack([0.5 * np.sin(2.6 * t) * smooth, 0.4 * np.sin(3.3 * t + 0.8) * smooth])
    motions = {"rig 1": Motion(), "rig 2": Motion(dof=2, phase_2_rad=math.pi / 2)}

    @functools.cache
    def of(name):
        if name.startswith("rigid"):
            return rigid_trial(both[:, : int(name[-1])])
        return run_case(read_parameters(), TrialCase(motions[name], 1.0, 1, 0))

    return of


def inspected(trial, directory, offset_s=None, **fields):
    """Findings of an import as (level, cause, text), and the sentence with which it ends.

    The offset of the clocks is determined, or the one that is set by hand.
    """
    WrittenTake(offset_s=0.7, **fields).write(trial, directory, 1)
    verdict, refusal = ImportVerdict("take"), ""
    mapping = read_mapping(directory / "map.toml")
    take = Take(directory / "take.csv", mapping, directory / "servo.csv", offset_s)
    try:
        Inspection(take, "motive", verdict).trial()
    except InputError as error:
        refusal = str(error)
    findings = [(f.level, f.cause, f.text.replace("\xa0", " ")) for f in verdict.findings]
    return findings, refusal.replace("\xa0", " ")


def named(*pairs):
    """Markers whose labels are exchanged in pairs."""
    return {"names": dict(pairs) | {b: a for a, b in pairs}}


def origin(*shift_m):
    return {"wrong": {"origin_m": (ORIGIN_M + np.array(shift_m)).tolist()}}


def conditions(**stated):
    """Change of a map: other conditions."""
    return {"changes": lambda document: document["trial"].update(stated)}


def columns(**sources):
    """Change of a map: other sources of the servo's columns; without a unit for None."""

    def change(document):
        for name, source in sources.items():
            entry = document["servo_columns"][name]
            entry.pop("unit") if source is None else entry.update(source)

    return {"changes": change}


def signals(**functions):
    """Change of a trial before its log is written: a function of each changed column."""

    def change(trial):
        changed = {n: f(trial.columns[n]) for n, f in functions.items()}
        return with_columns(trial, **changed)

    return {"signals": change}


def of_both(function):
    return signals(goal_1_rad=function, angle_1_rad=function)


def one_joint(document):
    document["trial"]["dof"] = 1
    for name in ("goal_2_rad", "angle_2_rad", "current_2_a"):
        document["servo_columns"].pop(name)


COUNTS = {"scale": 4096 / 360 * math.degrees(1)}
TWICE = {"scale": math.radians(1)}
ROWS = [(f"m{k:02d}", f"m{k + 12:02d}") for k in range(1, 5)]
MIRRORED = [(f"m{k:02d}", f"m{k + 1:02d}") for k in range(1, 17, 2)]

# fmt: off
REFUSED = {
    # Signs, joints and names
    "signs of both": ("rigid 2", {"signs": (-1.0, -1.0)}, "joint 1 and joint 2 count the other"),
    "sign of joint 2": ("rigid 2", {"signs": (1.0, -1.0)}, "joint 2 counts the other way"),
    "joints swapped": ("rig 2", {"swap_joints": True}, "joints 1 and 2 are swapped"),
    "one of two joints": ("rig 2", {"changes": one_joint}, "moves in two directions"),
    "markers of two rows": ("rigid 1", named(("m02", "m14")), "m02 and m14 are swapped"),
    "several markers": (
        "rigid 1", named(("m05", "m06"), ("m10", "m15")), "m05 and m06 are swapped, m10 and m15",
    ),
    "rows": ("rigid 1", named(*ROWS), "rows are named in the order"),
    "mirrored corners": ("rigid 1", named(*MIRRORED), "corners are named in the order"),
    "absent marker": ("rigid 1", {"absent": ("m16",)}, "m16 is mapped to"),
    # Frame
    "origin below": ("rigid 1", origin(0, 0, -0.42), "m too low"),
    "origin aside": ("rigid 1", origin(0.02, -0.03, 0), "m aside"),
    "y-up as z-up": ("rigid 1", {"wrong": {"up": "z"}}, "is y-up"),
    "yaw of 90 deg": ("rigid 1", {"wrong": {"yaw_deg": 90.0}}, "turned by 90.0 deg"),
    "left-handed": ("rig 1", {"wrong": {"mirror": "x"}}, "left-handed"),
    "base on a stand": ("rig 1", {"base": "stand", "align": "base"}, "fixed stand"),
    "base_offset_m": (
        "rig 2", {"base": "plate", "align": "base"} | conditions(base_offset_m=0.10),
        "0.060 m below the base plate",
    ),
    # Lengths and units
    "markers in mm": ("rig 1", {"scale": 1e3}, "in mm"),
    "scale of 1.1": ("rigid 1", {"scale": 1.1, "align": "rest"}, "times those of the link"),
    "length 5 cm off": ("rig 1", conditions(link_length_m=1.0), "rows of markers"),
    "angle in deg": ("rig 1", columns(angle_1_rad=None), "in deg"),
    "angles in counts": ("rig 1", columns(goal_1_rad=COUNTS, angle_1_rad=COUNTS), "counts"),
    "converted twice": ("rig 1", columns(goal_1_rad=TWICE, angle_1_rad=TWICE), "twice"),
    "current in mA": ("rig 1", columns(current_1_a=None), "mA"),
    "time in ms": ("rig 1", columns(time_s=None), "another unit"),
    "decimal commas": ("rigid 2", {"commas": True}, "decimal commas"),
    # Signals
    "constant angle": ("rig 1", signals(angle_1_rad=np.zeros_like), "does not change"),
    "centre of 180 deg": ("rig 1", of_both(lambda v: v + np.pi), "reads 180.0"),
    "zero 10 deg off": ("rig 1", of_both(lambda v: v + 0.17) | {"align": "rest"}, "elsewhere"),
    "smaller motion": ("rig 1", of_both(lambda v: 0.7 * v), "1.4"),
    "rest too long": ("rig 1", conditions(rest_samples=150), "within the 150 rest rows"),
    # Clocks
    "gap in the servo's log": ("rigid 1", {"gap_s": (4.0, 0.2)}, "has no samples for"),
    "60 Hz for 120": ("rig 1", {"rate_hz": 60.0}, "by 0.5"),
}
WARNED = {
    "origin 15 mm above": ("rigid 1", origin(0, 0, 0.015), "m too high"),
    "yaw of 3 deg": ("rigid 1", {"wrong": {"yaw_deg": 3.0}}, "turned by 3.0 deg"),
    "one row at rest": ("rigid 1", {"first_s": 0.017 * (REST - 1)}, "rest before the motion"),
    "width": ("rig 1", {"align": "rest"} | conditions(link_width_m=0.2), "corners"),
    "goals from the angle": ("rig 1", columns(goal_1_rad={"from": "pos1"}), "both taken from"),
    "goal and angle exchanged": (
        "rig 1", columns(goal_1_rad={"from": "pos1"}, angle_1_rad={"from": "goal1"}),
        "before goal_1_rad",
    ),
    "current without sign": ("rig 1", signals(current_1_a=np.abs), "never negative"),
    "unsigned current": (
        "rig 1", signals(current_1_a=lambda v: np.where(v < 0, v + 65.536, v)), "never negative",
    ),
    "sign of the current": ("rig 1", signals(current_1_a=np.negative), "sign is turned"),
    "currents swapped": (
        "rig 2", columns(current_1_a={"from": "cur2"}, current_2_a={"from": "cur1"}),
        "currents 1 and 2 are swapped",
    ),
    "another period": ("rig 1", conditions(period_s=2.0), "period of 2 s"),
    "frame rate 1 % off": ("rig 1", {"rate_hz": 119.0}, "drift apart"),
    "50 g as kg": ("rig 1", conditions(payload_kg=50.0), "folds"),
    "base_offset_m": (
        "rig 1", {"align": "rest"} | conditions(base_offset_m=0.03), "plate 0.060 m above",
    ),
}
# fmt: on
"""Trial, fields of the written take, and words of the sentence or the finding."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if trial.startswith("rig ") else ())
        for name, (trial, *_) in REFUSED.items()
    ],
)
def test_an_import_that_cannot_be_right_is_refused_with_its_cause(name, trials, tmp_path):
    trial, fields, words = REFUSED[name]
    findings, refusal = inspected(trials(trial), tmp_path, **fields)
    assert words in refusal, (findings, refusal)
    reasons = [text for level, _, text in findings if level == "refused"]
    assert not reasons or words in reasons[0]


@pytest.mark.parametrize("name", WARNED)
def test_a_doubtful_import_is_warned_of_with_its_cause(name, trials, tmp_path):
    trial, fields, words = WARNED[name]
    findings, refusal = inspected(trials(trial), tmp_path, **fields)
    assert not refusal
    assert any(level == "warning" and words in text for level, _, text in findings), findings


@pytest.mark.parametrize(
    ("trial", "align"), [("rig 1", "base"), ("rig 2", "none"), ("rig 2", "rest")]
)
def test_base_markers_on_their_plate_are_right(trial, align, trials, tmp_path):
    findings, refusal = inspected(trials(trial), tmp_path, base="plate", align=align)
    assert not refusal and {cause for _, cause, _ in findings} <= {"lean"}, findings


@pytest.mark.parametrize("first_s", [1.1, 2.4])
def test_a_recording_without_its_rest_is_not_blamed_on_frame_rate_or_zero(
    first_s, trials, tmp_path
):
    findings, refusal = inspected(trials("rig 1"), tmp_path, first_s=first_s)
    assert refusal and not {"rate", "zero"} & {cause for _, cause, _ in findings}


RIGHT = (
    {"offset_s": -1.3, "millimetres": True, "yaw_deg": -37.0, "lost": 0.01},
    {"offset_s": 0.8, "epoch_s": 1.7e9, "files_up": "z", "occluded": 0.02, "first_s": 0.3},
    {"offset_s": 1.9, "epoch_s": 1.7e9, "align": "rest", "first_s": 0.3},
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trial", "fields"), [*zip(["rigid 2", "rigid 1", "rigid 2"], RIGHT, strict=True)]
)
def test_right_imports_pass_and_their_clock_is_right(trial, fields, trials, tmp_path, capsys):
    take = WrittenTake(**fields)
    arguments = take.write(trials(trial), tmp_path, 4)
    code = main(["import", *arguments, "--out", str(tmp_path / "trials"), "--json"])
    printed, err = capsys.readouterr()
    assert code == 0, err
    offset_s = json.loads(printed)["offset_s"]
    assert offset_s == pytest.approx(take.offset_s - take.epoch_s, abs=1e-3)


@pytest.mark.parametrize(("late_s", "differs"), [(0.0005, ""), (0.02, "20.0"), (-0.5, "500.0")])
@pytest.mark.parametrize("epoch_s", [0.0, 1.7e9])
def test_an_offset_by_hand_is_compared_with_the_motion(epoch_s, late_s, differs, trials, tmp_path):
    offset_s = 0.7 - epoch_s + late_s
    findings, _ = inspected(trials("rigid 1"), tmp_path, offset_s, epoch_s=epoch_s)
    texts = [text for _, cause, text in findings if cause == "clock"]
    assert len(texts) == bool(differs)
    for text in texts:
        shown_ms = float(text.split("differs by ")[1].split()[0])
        assert shown_ms == pytest.approx(float(differs), abs=1.0)
