"""Interval of a prediction and its range: what widens the one and ends the other."""

import msgspec
import numpy as np
import onnx
import pytest

from firmware_py.inference.predictor import OnnxPredictor
from firmware_py.inference.range_check import RangeCount
from models.predictor.guarded_tip import INNOVATION_FACTOR
from models.predictor.interval import TipInterval
from models.predictor.onnx_graphs import to_onnx
from models.predictor.training import range_reasons
from tests.models.predictor.cases import guarded, made_up_rows


def observer_error_m(rows):
    return rows.tip_m - rows.observer_tip_m


def interval_of(rows, *wrong):
    """The interval of the observer's tip on these rows and with wrong plants."""
    return TipInterval.fit(rows.names, (rows.inputs, observer_error_m(rows), rows.run), wrong)


def column(rows, name):
    return rows.inputs[:, rows.names.index(name)]


def coverage(interval, inputs, error_m):
    """Fraction of the rows inside, by axis."""
    return (np.abs(error_m) <= interval.half_width(inputs)).mean(axis=0)


@pytest.mark.parametrize("bias_m", [0.0, 2e-3])
def test_the_interval_covers_trials_that_it_was_not_calibrated_on(bias_m):
    covered = []
    for seed in range(12):
        interval = interval_of(made_up_rows(seed=seed, bias_m=bias_m))
        fresh = made_up_rows(seed=seed + 100, bias_m=bias_m)
        covered.append(coverage(interval, fresh.inputs, observer_error_m(fresh)).mean())
    assert 0.93 <= np.mean(covered) <= 0.995


def test_the_interval_widens_with_what_makes_the_tip_uncertain():
    rows = made_up_rows()
    disturbed = rows.take(np.arange(len(rows)))
    column(disturbed, "innovation_1_a")[:] = 0.3
    disturbed.tip_m[:, 0] += 0.05 * column(rows, "bend_1_rad")
    wrong = (disturbed.inputs, observer_error_m(disturbed))
    interval = interval_of(rows, wrong)
    assert coverage(interval, *wrong).mean() > 0.93

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
    error_m = observer_error_m(rows)
    askew = [(rows.inputs, error_m + shift_m) for shift_m in ([0.004, 0, 0], [-0.004, 0, 0])]
    assert coverage(interval_of(rows), *askew[0])[0] < 0.5
    calibrated = interval_of(rows, *askew)
    assert all(coverage(calibrated, *wrong).min() >= 0.9 for wrong in askew)
    assert coverage(calibrated, rows.inputs, error_m).min() >= 0.95


def test_the_interval_covers_each_trial_with_a_wrong_plant_on_each_axis():
    rows = made_up_rows()
    wrong_m = observer_error_m(rows)
    one = rows.run < 2  # a third of the rows, part of which a quantile over all would miss
    wrong_m[one] += [0.006, 0.0, 0.003]
    interval = interval_of(rows, (rows.inputs, wrong_m))
    of_one = one & (np.abs(column(rows, "joint_rate_1_rad_s")) > 0.05)
    assert coverage(interval, rows.inputs[of_one], wrong_m[of_one]).min() >= 0.88
    standing, moving, swinging, moving_in_excess = interval.quantile
    assert (standing >= moving).all() and (swinging >= moving_in_excess).all()


def point(rows, **changes):
    """A row at zero bend, where the interval is narrow."""
    row = np.zeros((1, len(rows.names)))
    for name, value in changes.items():
        row[0, rows.names.index(name)] = value
    return row


@pytest.mark.parametrize("dof", [1, 2])
def test_a_large_innovation_ends_the_range_where_bend_passes_zero(dof):
    rows = made_up_rows(dof)
    model, innovation = guarded(rows), f"innovation_{dof}_a"
    largest_a = column(rows, innovation).max()
    usual, far = (
        point(rows, **{f"joint_rate_{dof}_rad_s": 0.3, innovation: factor * largest_a})
        for factor in (1, 4)
    )
    assert model.in_range(usual).all() and not model.in_range(far).any()
    assert (model.half_width(far) > model.half_width(usual) + 0.014).all()
    swinging = point(rows, **{innovation: 1.0, f"bend_rate_{dof}_rad_s": 0.3})
    assert model.in_range(swinging).all(), "the joints stand"


def test_the_bound_is_a_multiple_of_the_largest_innovation_of_rows_that_move():
    rows = made_up_rows()
    moving = np.abs(column(rows, "joint_rate_1_rad_s")) > 0.05
    innovation_a = column(rows, "innovation_1_a")
    innovation_a[~moving] = 1.0  # a link that swings freely sets no bound
    assert guarded(rows).innovation_a == pytest.approx(
        INNOVATION_FACTOR * innovation_a[moving].max()
    )


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
    counted = range_reasons(model, points)
    assert [(i.name, i.ticks) for i in counted.inputs] == [
        ("bend_1_rad", 7), (f"innovation_{dof}_a", 5),
    ]  # fmt: skip
    assert counted.wide_ticks == counted.late_ticks == 4 and counted.widest_m > 0.015
    facts = {"features": msgspec.to_builtins(model.ranges()), "dof": dof}
    graph = to_onnx(model.write_graph, len(rows.names), facts)
    onnx.save(graph, tmp_path / "predictor.onnx")
    robot, outside = OnnxPredictor(tmp_path / "predictor.onnx", dof), 0
    count = RangeCount(robot.ranges)
    for row in points:
        angle_rad, current_a, (di, age_s), signals = np.split(row, [dof, 2 * dof, 2 * dof + 2])
        answer = robot.predict(angle_rad, current_a, di, signals, age_s)
        if not answer.in_range:
            outside += 1
            count.add(row, answer.half_width_m, age_s)
    assert outside == (~model.in_range(points)).sum() == 16
    assert count.reasons() == counted
