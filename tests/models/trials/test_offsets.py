"""Offsets are found without the lag of the bend; signs, second peaks and edges are told."""

import numpy as np
import pytest

from firmware_py.link.link_description import STUDY_LINK
from models.trials.clock import (
    ClockSignal,
    edge_offsets,
    find_peaks,
    fit_offset,
    nominal_bend_ratio,
    rising_edges_s,
)
from models.trials.trial import TrialMeta

LENGTH_M, BASE_M = 0.95, 0.06
ROOT_STIFFNESS_NM_RAD, BENDING_STIFFNESS_N_M2, SHEAR_STIFFNESS_N = 350.0, 135.0, 2000.0
META = TrialMeta(
    dof=1, payload_kg=0.0, trial=1, motion="sinusoid", source="measured", period_s=4.0,
    rest_samples=1, **STUDY_LINK.conditions(),
)  # fmt: skip


def swing(time_s):
    """Rest, two cycles of 4 s with a smooth start, rest."""
    t = np.clip(time_s - 1.0, 0, 8.0)
    return 0.5 * np.sin(np.pi / 2 * t) * np.clip(t / 2, 0, 1) ** 2


def bent(time_s, angle, force_n, late_s):
    """Direction of row 1 and turn to row 2 of a beam whose bend, not its shear, lags."""

    def across(z_m, force, late):
        whole = LENGTH_M / ROOT_STIFFNESS_NM_RAD * z_m
        whole += (LENGTH_M * z_m**2 / 2 - z_m**3 / 6) / BENDING_STIFFNESS_N_M2
        return late * whole + force * z_m / SHEAR_STIFFNESS_N

    force = force_n * angle
    late = np.interp(time_s - late_s, time_s, force)
    first, second = (across(z, force, late) for z in (LENGTH_M / 4, LENGTH_M / 2))
    below = first / (BASE_M + LENGTH_M / 4)
    return angle + below, (second - first) / (LENGTH_M / 4) - below


@pytest.mark.parametrize("force_n", [5.0, 25.0])
def test_the_lag_of_the_bend_is_left_out(force_n):
    time_s = np.arange(0, 11, 1 / 240)
    rng = np.random.default_rng(2)
    seen, bend = bent(time_s, swing(time_s), force_n, 0.08)
    seen = seen + 2e-4 * rng.standard_normal(len(time_s))
    bend = bend + 4e-4 * rng.standard_normal(len(time_s))
    servo_s = np.arange(0, 11, 0.017)
    angle = ClockSignal(servo_s - 1.3, swing(servo_s)[:, None])
    fit = fit_offset(
        angle, ClockSignal(time_s, seen[:, None]), bend[:, None],
        nominal_bend_ratio(META), 1.305,
    )  # fmt: skip
    assert fit.offset_s == pytest.approx(1.3, abs=5e-4)
    assert abs(fit.offset_s - 1.3) < 1.5 * fit.error_s < 3e-3  # an interval of 95 %
    assert fit.lag_s > 0.5 * 0.08 * force_n * 3e-3  # it would have been taken for clock


def test_a_turned_sign_is_better_than_a_shift_by_half_a_period():
    time_s = np.arange(0, 11, 0.01)
    angle = ClockSignal(time_s, -swing(time_s)[:, None])
    peaks = find_peaks(angle, ClockSignal(time_s + 0.7, swing(time_s)[:, None]))
    best = max(peaks, key=lambda p: p.correlation)
    assert not best.as_mapped and best.offset_s == pytest.approx(0.7, abs=0.011)
    mapped = max((p for p in peaks if p.as_mapped), key=lambda p: p.correlation)
    assert mapped.correlation < 0.97


def test_a_motion_without_rest_has_a_second_peak():
    time_s = np.arange(0, 16, 0.01)
    value = np.sin(np.pi / 2 * time_s)[:, None]
    peaks = find_peaks(ClockSignal(time_s, value), ClockSignal(time_s, value))
    mapped = [p for p in peaks if p.as_mapped]
    assert len(mapped) == 2 and mapped[1].correlation > 0.99


def test_edges_give_the_offset_and_miss_no_run():
    time_s = np.arange(0, 10, 0.01)
    level = np.where((time_s % 2.0 > 1.0) ^ (time_s > 7.3), 3.3, 0.0)
    edges_s = rising_edges_s(time_s, level)
    (found,) = edge_offsets(edges_s - 4.2, edges_s)
    assert found.offset_s == pytest.approx(4.2) and found.error_s < 0.011  # one grid of samples
    assert edge_offsets(edges_s[2:] - 4.2, edges_s)[0].offset_s == pytest.approx(4.2)
    assert edge_offsets(np.zeros((0, 2)), edges_s) == []
    assert len(edge_offsets(edges_s[:1], edges_s)) == len(edges_s)  # which of them?


def test_edges_between_samples_leave_an_interval_that_holds_the_offset():
    """A log with a step of 17 ms and cameras at 120 Hz see uneven pulses."""
    rng = np.random.default_rng(4)
    pulses_s = np.cumsum(rng.uniform(0.4, 0.9, 12))

    def edges_s(step_s, until_s=9.0):
        time_s = np.arange(0, until_s, step_s)
        on = np.any((time_s[:, None] > pulses_s) & (time_s[:, None] < pulses_s + 0.1), axis=1)
        return rising_edges_s(time_s, 3.3 * on)

    (found,) = edge_offsets(edges_s(0.017) + 1.234, edges_s(1 / 120))
    assert found.low_s < -1.234 < found.high_s and found.error_s < 0.006  # 8.5 + 4.2 of one edge
    (lost,) = edge_offsets(edges_s(0.017, 6.0)[2:] + 1.234, edges_s(1 / 120))
    assert lost.low_s < -1.234 < lost.high_s


@pytest.mark.parametrize(("rate_error", "step_s"), [(0.0, 0.001), (3e-4, 0.001), (-2e-4, 0.001)])
def test_edges_tell_how_far_the_clocks_drift_apart(rate_error, step_s):
    rises_s = np.cumsum([0.3, 0.7, 0.45, 0.9, 0.61, 1.3, 0.52, 0.83, 0.71, 1.1, 0.66])

    def edges(own_rate):
        time_s = np.arange(0, 10, step_s) * own_rate
        true_s = time_s / own_rate
        high = np.any([(true_s >= rise) & (true_s < rise + 0.1) for rise in rises_s], axis=0)
        return rising_edges_s(time_s, 5.0 * high)

    (found,) = edge_offsets(edges(1 + rate_error), edges(1.0))
    over_s = rises_s[-1] - rises_s[0]
    assert found.drift.over_s == pytest.approx(over_s, abs=2 * step_s)
    assert found.drift.change_s == pytest.approx(-rate_error * over_s, abs=4e-4)
    assert 1e-4 < found.drift.deviation_s < 6e-4
