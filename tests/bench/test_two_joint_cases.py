"""Cases of the gap benchmark with two joints."""

from bench.gap.case_run import bench_trials, sealed_trials
from bench.gap.cases import draw_cases
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
    sealed = sealed_trials(rig, 1, 2)
    for trial in [*bench_trials(rig, 1, 2), *sealed.values()]:
        assert trial.angle_rad.shape[1] == 2
        assert trial.goal_rad[:, 1].any()
