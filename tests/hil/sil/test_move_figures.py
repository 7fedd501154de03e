"""Settling time and swing on a tip that is known in closed form."""

import msgspec
import numpy as np
import pytest

from firmware_py.goals.tip_plan import TipPlan
from firmware_py.link.link_facts import STUDY_FACTS
from hil.sil.tip_errors import CLOSE_M, move_figures

PERIOD_S = 0.01


def plan_of(desired, moves):
    return TipPlan(
        schema=1, path="point_to_point", method="inverse", dof=1, period_s=PERIOD_S, rest_s=0.0,
        start_row=0, end_row=len(desired), drawn=(), desired_m=(tuple(desired),), payloads=(),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
        moves=moves,
    )  # fmt: skip


def test_a_decaying_swing_settles_when_its_envelope_says():
    time_s = PERIOD_S * np.arange(1000)
    swing = 0.1 * np.exp(-time_s) * np.cos(2 * np.pi * 2.0 * time_s)
    tip = (0.3 + swing)[:, None]
    (own,) = move_figures(tip, plan_of(np.full(1000, 0.31), ((0, 50, 1000),)))
    assert own.settling_s == pytest.approx(np.log(0.1 / CLOSE_M), abs=0.25)
    assert own.swing_m == pytest.approx(0.1 * np.exp(-0.5), rel=0.15)
    assert own.offset_m == pytest.approx(0.01, abs=1e-4)
    assert own.command_s == pytest.approx(0.5)


def test_ticks_without_a_measurement_do_not_count():
    tip = np.full((100, 1), 0.2)
    tip[40] = np.nan
    plan = plan_of(np.full(100, 0.2), ((0, 10, 100),))
    (own,) = move_figures(tip, plan)
    assert (own.settling_s, own.swing_m, own.offset_m) == (0.0, 0.0, pytest.approx(0.0))
    assert move_figures(tip, msgspec.structs.replace(plan, moves=())) == ()
