"""A motion capture that was set up anew is turned a little: that is no gap."""

import pytest

from models.gap.residuals.fit_parameters import effect_candidates, nuisance_fit_parameters


@pytest.mark.slow
def test_a_frame_that_was_set_up_anew_is_no_gap(plant, hidden, diagnosed):
    found = diagnosed(
        plant,
        hidden(
            marker_frame_roll_rad=0.003, marker_frame_tilt_rad=0.0005, marker_frame_yaw_rad=-0.003
        ),
    )
    assert found.verdict == "no gap" and not found.named


def test_a_turn_about_a_joints_axis_is_an_effect(plant):
    """It looks like an offset of the joint's encoder, so the session's turn is small there."""
    for dof, strengths in ((1, ["tilt"]), (2, ["tilt", "roll"])):
        effect = effect_candidates(plant, "marker_frame_tilt", dof)["marker_frame_tilt"]
        assert [q.name for q in effect] == [f"marker_frame_{n}_rad" for n in strengths]
        turns = {
            name: q.standard_deviation
            for q in nuisance_fit_parameters(plant, dof)
            for name in q.parameters if name.startswith("marker_frame_")
        }  # fmt: skip
        assert len(turns) == 3
        small = {name for name, deviation in turns.items() if deviation < 0.001}
        assert small == {q.name for q in effect}
        assert turns["marker_frame_yaw_rad"] == pytest.approx(0.005)
