"""Cases of the gap benchmark with two joints."""

from bench.gap.case_run import bench_trials
from bench.gap.cases import BenchCase, draw_cases
from bench.gap.sealed_errors import SealedErrors
from models.rig.drawn_rig import rig_named


def test_only_two_joints_hide_a_coupling_of_the_planes():
    hidden = {
        joints: {e for c in draw_cases(1, 0, 0, 0, 0, "drive", joints=joints) for e in c.hidden}
        for joints in (1, 2)
    }
    assert hidden[2] - hidden[1] == {"cross_axis_coupling"}
    assert not hidden[1] - hidden[2]


def test_trials_and_sealed_trials_drive_as_many_joints_as_the_case():
    rig = rig_named("default")
    case = BenchCase("single", {"dead_time": 0.03}, {}, 1, joints=2)
    sealed = [t for pair in SealedErrors(rig, case).trials.values() for t in pair]
    assert len(sealed) == 4
    for trial in [*bench_trials(rig, 1, 2), *sealed]:
        assert trial.angle_rad.shape[1] == 2
        assert trial.goal_rad[:, 1].any()
