"""A bound on the innovation: moving joints that exceed it are out of range, bent or not."""

import numpy as np
import pytest

from models.predictor.candidates import ObserverTip
from models.predictor.guarded_tip import GuardedTip
from models.predictor.interval import FACTOR, InnovationBound, TipInterval
from tests.models.predictor.tip_cases import made_up_rows


def point(rows, **changes):
    """A row at zero bend, where the interval is narrow."""
    row = np.zeros((1, len(rows.names)))
    for name, value in changes.items():
        row[0, rows.names.index(name)] = value
    return row


def guarded(rows):
    predictor = ObserverTip(0).fit(rows)
    error_m = rows.tip_m - predictor.predict(rows.inputs)
    return GuardedTip.of(
        rows, predictor, TipInterval.fit(rows.names, (rows.inputs, error_m, rows.run))
    )


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
    assert InnovationBound.of(rows).bound_a == pytest.approx(FACTOR * innovation[moving].max())
    still = rows.take(~moving)
    assert not InnovationBound.of(still).exceeded(rows.inputs).any()
