"""Choice among candidates, and the interval of the chosen one."""

import msgspec
import numpy as np
import pytest

from models.predictor.candidates import CorrectedTip, ObserverTip
from models.predictor.interval import TipInterval
from models.predictor.learners import CANDIDATES
from models.predictor.observed_trials import ASKEW_RAD, askew_shifts_m
from models.predictor.training import choose_tip_predictor, group_folds
from tests.models.predictor.tip_cases import made_up_rows


def test_folds_leave_out_each_payload_and_each_motion():
    rows = made_up_rows()
    folds = group_folds(rows)
    assert len(folds) == 5  # three payloads, two motions
    for train, test in folds:
        assert not set(train) & set(test) and len(train) + len(test) == len(rows)
        own = {*rows.payload_kg[test]}, {*rows.motion[test]}
        others = {*rows.payload_kg[train]}, {*rows.motion[train]}
        assert any(not mine & theirs for mine, theirs in zip(own, others, strict=True))


def test_rows_of_one_payload_and_motion_leave_out_trials():
    rows = made_up_rows(payloads_kg=(1.0,))
    rows.motion[:] = "sinusoid"
    assert [set(rows.run[test]) for _, test in group_folds(rows)] == [{k} for k in range(6)]


def test_a_correction_is_chosen_where_it_helps_and_none_where_it_does_not():
    rows = made_up_rows()
    corrected = choose_tip_predictor(rows, [], (ObserverTip, CorrectedTip))
    assert (corrected.chosen.name, corrected.chosen.variant) == ("corrected observer", 2)
    exact = rows.take(np.arange(len(rows)))
    exact.tip_m[:] = exact.observer_tip_m + 1e-4 * np.random.default_rng(1).normal(size=(1200, 3))
    plain = choose_tip_predictor(exact, [], (ObserverTip, CorrectedTip))
    assert plain.chosen.name == "observer"
    assert plain.candidates[1].variant == 0


def test_every_candidate_beats_none_and_says_how_it_did():
    choice = choose_tip_predictor(made_up_rows(), [])
    assert [c.name for c in choice.candidates] == [c.name for c in CANDIDATES]
    for result in choice.candidates:
        score = msgspec.structs.asdict(result.nested)
        assert 0 < score["mean_m"] <= score["p95_m"] <= score["max_m"]
        assert 0 <= score["coverage"] <= 1 and 0 <= score["in_range"] <= 1


@pytest.mark.parametrize("bias_m", [0.0, 2e-3])
def test_the_interval_covers_trials_that_it_was_not_calibrated_on(bias_m):
    coverage = []
    for seed in range(12):
        seen = made_up_rows(seed=seed, bias_m=bias_m)
        fresh = made_up_rows(seed=seed + 100, bias_m=bias_m)
        error_m = seen.tip_m - seen.observer_tip_m
        interval = TipInterval.fit(seen.names, (seen.inputs, error_m, seen.run))
        inside = np.abs(fresh.tip_m - fresh.observer_tip_m) <= interval.half_width(fresh.inputs)
        coverage.append(inside.mean())
    assert 0.93 <= np.mean(coverage) <= 0.995


def test_the_interval_widens_with_what_makes_the_tip_uncertain():
    rows = made_up_rows()
    disturbed = rows.take(np.arange(len(rows)))
    excess = [rows.names.index("innovation_1_a")]
    bend = rows.inputs[:, rows.names.index("bend_1_rad")]
    disturbed.inputs[:, excess] = 0.3
    disturbed.tip_m[:, 0] += 0.05 * bend
    error_m = rows.tip_m - rows.observer_tip_m
    wrong = (disturbed.inputs, disturbed.tip_m - disturbed.observer_tip_m)
    interval = TipInterval.fit(rows.names, (rows.inputs, error_m, rows.run), [wrong])
    inside = np.abs(wrong[1]) <= interval.half_width(wrong[0])
    assert inside.mean() > 0.93

    def width(**changes):
        point = rows.inputs[:1].copy()
        for name, value in ({"joint_rate_1_rad_s": 0.3, "bend_1_rad": 0.1} | changes).items():
            point[0, rows.names.index(name)] = value
        return interval.half_width(point)[0, 0]

    assert width(innovation_1_a=0.3) > 2 * width(innovation_1_a=0.0)
    assert width(age_s=0.034) > width(age_s=0.017) > width(age_s=0.0)
    still = {"joint_rate_1_rad_s": 0.0, "age_s": 0.034}
    assert width(**still, bend_rate_1_rad_s=1.0) > width(**still, bend_rate_1_rad_s=0.0)


def test_the_interval_covers_a_wrong_plant_that_the_innovation_does_not_show():
    rows = made_up_rows()
    error_m = rows.tip_m - rows.observer_tip_m
    calibration = (rows.inputs, error_m, rows.run)
    askew = [(rows.inputs, error_m + shift_m) for shift_m in ([0.004, 0, 0], [-0.004, 0, 0])]
    alone = TipInterval.fit(rows.names, calibration)
    warned = TipInterval.fit(rows.names, calibration, askew)
    assert (np.abs(askew[0][1]) <= alone.half_width(rows.inputs)).mean(axis=0)[0] < 0.5
    for _, wrong_m in askew:
        assert (np.abs(wrong_m) <= warned.half_width(rows.inputs)).mean(axis=0).min() >= 0.9
    assert (np.abs(error_m) <= warned.half_width(rows.inputs)).mean(axis=0).min() >= 0.95


def test_a_violent_motion_widens_the_interval_only_so_far():
    rows = made_up_rows()
    error_m = rows.tip_m - rows.observer_tip_m
    wrong = (rows.inputs, 5.0 * error_m)
    interval = TipInterval.fit(rows.names, (rows.inputs, error_m, rows.run), [wrong])
    point = np.repeat(rows.inputs[:1], 2, axis=0)
    point[:, rows.names.index("innovation_1_a")] = 0.1, 1.0
    first, second = interval.half_width(point)
    assert first == pytest.approx(second)


def test_the_angle_of_mounting_is_what_widens_an_interval_of_a_right_plant():
    rows = made_up_rows()
    widths_m = [
        choose_tip_predictor(rows, [], (ObserverTip,), askew_rad=askew_rad)
        .chosen.predictor.half_width(rows.inputs)[:, 0].mean()
        for askew_rad in (0.0, 0.005, 0.01)
    ]  # fmt: skip
    assert widths_m[0] < widths_m[1] < widths_m[2]
    assert not askew_shifts_m(rows, 0.0)


def test_a_link_mounted_askew_shifts_the_tip_in_the_plane_of_a_joint():
    rows = made_up_rows(dof=2)
    angles = [rows.names.index(f"angle_{j}_rad") for j in (1, 2)]
    rows.inputs[:, angles] = 0.0
    rows.tip_m[:] = [0.0, 0.0, 1.0]
    shifts_m = [shift_m[0] for shift_m in askew_shifts_m(rows)]
    a = ASKEW_RAD
    assert np.allclose(shifts_m, [[-a, 0, 0], [a, 0, 0], [0, -a, 0], [0, a, 0]])
    rows.inputs[:, angles[0]] = np.pi / 2  # the link points along x; plane 1 is x and z
    rows.tip_m[:] = [1.0, 0.0, 0.0]
    shifts_m = [shift_m[0] for shift_m in askew_shifts_m(rows)]
    assert np.allclose(shifts_m, [[0, 0, a], [0, 0, -a], [0, -a, 0], [0, a, 0]])


def test_the_interval_covers_each_trial_with_a_wrong_plant_on_each_axis():
    rows = made_up_rows()
    error_m = rows.tip_m - rows.observer_tip_m
    wrong_m = error_m.copy()
    one = rows.run < 2  # a third of the rows, which a quantile of all would leave out in part
    wrong_m[one] += [0.006, 0.0, 0.003]
    wrong = (rows.inputs, wrong_m)
    interval = TipInterval.fit(rows.names, (rows.inputs, error_m, rows.run), [wrong])
    moving = np.abs(rows.inputs[:, rows.names.index("joint_rate_1_rad_s")]) > 0.05
    inside = np.abs(wrong_m) <= interval.half_width(rows.inputs)
    assert inside[one & moving].mean(axis=0).min() >= 0.88
    standing, moving, swinging, moving_in_excess = interval.quantile
    assert (standing >= moving).all() and (swinging >= moving_in_excess).all()
