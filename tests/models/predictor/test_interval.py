"""Interval of a prediction and its range: what widens the one and ends the other."""

import msgspec
import numpy as np
import onnx
import pytest

from firmware_py.commands.range_check import RangeCount
from firmware_py.inference.predictor import OnnxPredictor
from models.predictor.guarded_tip import INNOVATION_FACTOR
from models.predictor.interval import TipInterval
from models.predictor.onnx_graphs import to_onnx
from models.predictor.training import range_reasons
from tests.models.predictor.cases import guarded, made_up_rows


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


def point(rows, **changes):
    """A row at zero bend, where the interval is narrow."""
    row = np.zeros((1, len(rows.names)))
    for name, value in changes.items():
        row[0, rows.names.index(name)] = value
    return row


@pytest.mark.parametrize("dof", [1, 2])
def test_an_innovation_far_above_the_usual_ends_the_range_where_bend_passes_zero(dof):
    rows = made_up_rows(dof)
    model, rate = guarded(rows), {f"joint_rate_{dof}_rad_s": 0.3}
    largest_a = rows.inputs[:, rows.names.index(f"innovation_{dof}_a")].max()
    usual = point(rows, **rate, **{f"innovation_{dof}_a": largest_a})
    far = point(rows, **rate, **{f"innovation_{dof}_a": 4 * largest_a})
    assert model.in_range(usual).all()
    assert not model.in_range(far).any()
    assert (model.half_width(far) > model.half_width(usual) + 0.014).all()


def test_a_link_that_swings_behind_joints_that_stand_stays_in_range():
    rows = made_up_rows()
    model = guarded(rows)
    assert model.in_range(point(rows, innovation_1_a=1.0, bend_rate_1_rad_s=0.3)).all()


def test_the_bound_is_a_multiple_of_the_largest_innovation_of_rows_that_move():
    rows = made_up_rows()
    rate, innovation = (
        rows.inputs[:, rows.names.index(name)] for name in ("joint_rate_1_rad_s", "innovation_1_a")
    )
    innovation[np.abs(rate) < 0.05] = 1.0  # a link that swings freely sets no bound
    moving = np.abs(rate) > 0.05
    bound_a = guarded(rows).innovation_a
    assert bound_a == pytest.approx(INNOVATION_FACTOR * innovation[moving].max())
    still = rows.take(~moving)
    assert not guarded(still).innovation_exceeded(rows.inputs).any()


@pytest.mark.parametrize("dof", [1, 2])
def test_training_counts_the_causes_that_the_robot_counts(dof, tmp_path):
    """Each cause alone, on rows of which most are in range."""
    rows = made_up_rows(dof)
    model, points = guarded(rows), 0.5 * rows.inputs[:200]
    columns = {name: rows.names.index(name) for name in rows.names}
    points[:7, columns["bend_1_rad"]] = 2.0
    points[10:15, columns[f"innovation_{dof}_a"]] = 1.0
    points[10:15, columns[f"joint_rate_{dof}_rad_s"]] = 0.3
    points[20:24, columns["age_s"]] = 0.5
    told = range_reasons(model, points)
    assert [(i.name, i.ticks) for i in told.inputs] == [
        ("bend_1_rad", 7), (f"innovation_{dof}_a", 5),
    ]  # fmt: skip
    assert told.wide_ticks == told.late_ticks == 4 and told.widest_m > 0.015
    facts = {"features": msgspec.to_builtins(model.ranges()), "dof": dof}
    onnx.save(to_onnx(model, len(rows.names), facts), tmp_path / "predictor.onnx")
    robot, count = OnnxPredictor(tmp_path / "predictor.onnx", dof), 0
    watched = RangeCount(robot.ranges)
    for point in points:
        first = 2 * dof + 1
        answer = robot.predict(
            point[:dof], point[dof : first - 1], point[first - 1], point[first + 1 :], point[first]
        )
        if not answer.in_range:
            count += 1
            watched.add(point, answer.half_width_m, point[first])
    assert count == (~model.in_range(points)).sum() == 16
    assert watched.reasons() == told
