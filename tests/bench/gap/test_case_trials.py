"""Joints and motions of the gap benchmark's cases."""

from types import SimpleNamespace

import numpy as np
import pytest

from bench.gap import __main__ as command
from bench.gap import benchmark_run, case_run, rig_plants, sealed_errors
from bench.gap.case_run import bench_trials
from bench.gap.cases import (
    MOTIONS,
    PAYLOAD_SETS,
    BenchCase,
    draw_cases,
    in_one_servo,
    motion_named,
)
from bench.gap.rig_plants import plant_of_rig, plants_of_rigs
from bench.gap.sealed_errors import SealedErrors
from models.rig.drawn_rig import rig_named


def test_only_two_joints_hide_a_coupling_of_the_planes():
    hidden = {
        joints: {e for c in draw_cases(1, 0, 0, 0, 0, "drive", joints=joints) for e in c.hidden}
        for joints in (1, 2)
    }
    assert hidden[2] - hidden[1] == {"cross_axis_coupling"}
    assert not hidden[1] - hidden[2]


@pytest.fixture
def ran(monkeypatch):
    """Rigs and conditions of the trials that were run; no link moves, which would take minutes."""
    ran = []

    def stand_still(rig, conditions):
        ran.append((rig, conditions))
        still = np.zeros((2, conditions.motion.dof))
        return SimpleNamespace(name="still", angle_rad=still, goal_rad=still)

    for module in (case_run, sealed_errors):
        monkeypatch.setattr(module, "run_case", stand_still)
    return ran


def test_trials_and_sealed_trials_drive_as_many_joints_as_the_case(ran):
    rig = rig_named("default")
    case = BenchCase("single", {"dead_time": 0.03}, {}, 1, joints=2)
    assert len(SealedErrors(rig, case).trials) == 2
    late = [p["servo.dead_time_s"] - rig["servo.dead_time_s"] for p, _ in ran]
    assert late == pytest.approx([0.03, 0.0] * 2)  # with the effect and without
    bench_trials(rig, 1, 2)
    assert len(ran) == 10
    assert {c.motion.dof for _, c in ran} == {2}


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_trials_follow_the_motion_of_their_case(name, ran):
    bench_trials(rig_named("default"), 1, 1, name)
    assert {c.motion for _, c in ran} == {motion_named(name, 1)}
    assert sorted({(c.payload_kg, c.trial) for _, c in ran}) == [
        (payload_kg, trial) for payload_kg in PAYLOAD_SETS["study"] for trial in (1, 2)
    ]


def test_a_rig_has_a_plant_for_each_motion_and_number_of_joints(tmp_path):
    names = {
        (1, "study"): "drawn_3.json", (2, "study"): "drawn_3_2dof.json",
        (1, "slow"): "drawn_3_slow.json", (2, "slow"): "drawn_3_2dof_slow.json",
    }  # fmt: skip
    for name in names.values():
        (tmp_path / name).touch()
    assert {k: plant_of_rig("drawn_3", tmp_path, *k).name for k in names} == names
    robots = [("drawn_3", *own) for own in names]
    assert plants_of_rigs(robots, tmp_path) == {r: tmp_path / names[r[1:]] for r in robots}


def test_patterns_are_measured_once_for_a_motion_and_go_with_its_cases(monkeypatch, tmp_path):
    measured, ran = [], []

    def measure(work, rigs, executor, on_done):
        measured.append((work.directory.name, list(rigs), len(work.diagnosed_on)))
        work.directory.mkdir(parents=True)

    monkeypatch.setattr(rig_plants, "run_pattern_work", measure)
    monkeypatch.setattr(rig_plants, "learned_patterns", lambda files: ())
    for _ in range(2):
        path = rig_plants.patterns_of_protocol(tmp_path, 3, 1, "slow")
        assert path.exists()
    assert measured == [("slow_1dof", [0, 1, 2], 3)]

    monkeypatch.setattr(
        benchmark_run, "plants_of_rigs", lambda own, _: dict.fromkeys(own, tmp_path / "plant.json")
    )
    monkeypatch.setattr(
        benchmark_run, "run_campaign_cases", lambda cases, *_: ran.extend(cases) or None
    )
    (tmp_path / "plant.json").touch()
    (tmp_path / "calibration").mkdir()
    path.parent.rename(tmp_path / "calibration" / "slow_1dof")
    cases = [
        BenchCase("null", {}, {}, n, "drawn_1", motion=m) for n, m in ((1, "study"), (2, "slow"))
    ]
    benchmark_run.run_benchmark(cases, None, tmp_path, sealed=False, calibration_rigs=3)
    with_patterns = {c.config.case.motion: bool(c.config.patterns) for c in ran}
    assert with_patterns == {"study": False, "slow": True}
    assert len(measured) == 1


def test_rigs_take_the_motions_in_turn(monkeypatch, tmp_path):
    ran = []

    def run(cases, *_):
        ran.extend(cases)
        return SimpleNamespace(ran={})

    monkeypatch.setattr(command, "run_benchmark", run)
    monkeypatch.setattr(command, "write_bench_summary", lambda directory: ({}, {}))
    arguments = "--rigs drawn_1 drawn_2 drawn_3 --most 2 --motions slow triangle --no-sealed"
    monkeypatch.setattr("sys.argv", ["bench.gap", *arguments.split(), "--out", str(tmp_path)])
    command.main()
    assert [(c.rig, c.motion) for c in ran] == [
        ("drawn_1", "slow"), ("drawn_1", "slow"), ("drawn_2", "triangle"),
        ("drawn_2", "triangle"), ("drawn_3", "slow"), ("drawn_3", "slow"),
    ]  # fmt: skip


def test_plants_may_be_of_another_motion_than_the_trials(monkeypatch, tmp_path):
    asked = []

    def plants(robots, _):
        asked.extend(robots)
        return dict.fromkeys(robots, tmp_path / "plant.json")

    monkeypatch.setattr(benchmark_run, "plants_of_rigs", plants)
    monkeypatch.setattr(benchmark_run, "run_campaign_cases", lambda cases, *_: None)
    (tmp_path / "plant.json").touch()
    case = BenchCase("null", {}, {}, 1, "drawn_1", motion="small")
    for motion in ("", "study"):
        benchmark_run.run_benchmark([case], None, tmp_path, sealed=False, plant_motion=motion)
    assert asked == [("drawn_1", 1, "small"), ("drawn_1", 1, "study")]


def test_effects_of_one_servo_are_each_in_a_joint_and_others_are_left_out():
    rig = rig_named("drawn_3")
    drawn = list(draw_cases(1, 1, 1, 0, seed=3, rig="drawn_3", joints=2))
    cases = in_one_servo(drawn, rig)
    hidden = {e for c in cases for e in c.hidden}
    assert {"coulomb_friction", "current_bias"} <= hidden
    assert not hidden & {"creep", "unmodelled_payload", "marker_scale"}
    assert {c.joint for c in cases if c.hidden} == {1, 2}
    assert [c.joint for c in cases if c.kind == "null"] == [None]
    case = next(c for c in cases if c.hidden)
    (name,) = case.hidden
    assert case.added_to_rig == {f"{name}:{case.joint}": case.hidden[name]}
    rig.hide(case.added_to_rig)


def test_sealed_trials_are_refused_with_motions_of_ones_own(monkeypatch, tmp_path, capsys):
    arguments = ["--rigs", "drawn_1", "--motions", "slow", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", ["bench.gap", *arguments])
    with pytest.raises(SystemExit):
        command.main()
    assert "--no-sealed" in capsys.readouterr().err
