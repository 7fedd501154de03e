"""Findings of the paper on toy trials whose result is known."""

import numpy as np

from models.study.findings import hysteresis_loop


def test_findings_that_the_toy_was_built_with_come_out(toy_study):
    holds = {f.claim: f.holds for f in toy_study.document.findings}
    assert holds["DI rises with payload"] is True
    assert holds["Degree 1 is worst"] is True
    assert holds["DI helps at every degree"] is True  # the toy's servo has friction
    assert holds["DI shows hysteresis at high payload"] is True  # and its bend lags
    assert holds["Negative angles deform more"] is False  # it is symmetric
    assert holds["2DOF deforms more than 1DOF"] is None  # nothing to compare with


def test_a_loop_is_wide_only_where_the_link_lags(make_trial):
    time_s = 0.017 * np.arange(532)
    angle_rad = -0.5 * np.sin(2 * np.pi * np.maximum(time_s - time_s[20], 0) / 4.352)
    bend = 0.01 * angle_rad**2
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(time_s))
    speed = np.abs(np.gradient(angle_rad))
    rising = (np.gradient(angle_rad) > 0) * speed / speed.max()
    follows = hysteresis_loop(make_trial(angle_rad, stretch=1.001 + bend + noise, rest_samples=20))
    lags = hysteresis_loop(
        make_trial(angle_rad, stretch=1.001 + bend + noise + 1e-3 * rising, rest_samples=20)
    )
    assert follows.width < 3 * follows.noise
    assert lags.width > 3 * lags.noise
    assert 0.6e-3 < lags.width < 1e-3  # the branches stand 1e-3 apart at zero, less beside it
