"""Residual of some of the signals: of the currents, or of the tip."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision.evidence import signal_residual

POINT = SimpleNamespace(rows=[])


def search(*sizes, signals=("current_1_a", "di", "tip_x_m", "tip_z_m")):
    """Search whose residual has a size in each trial and signal, by group (trials, signals)."""
    rows = [np.ones((1, 1, 8)) * np.asarray(size, dtype=float)[:, :, None] for size in sizes]
    groups = [SimpleNamespace(signals=signals) for _ in sizes]
    first = SimpleNamespace(residuals=SimpleNamespace(groups=groups), whitened=lambda given: rows)
    return SimpleNamespace(first=first)


def test_only_the_signals_that_are_asked_for_count():
    found = search([[3, 9, 1, 1], [1, 9, 3, 1]])
    assert signal_residual(found, POINT, "current_") == pytest.approx(5.0)
    assert signal_residual(found, POINT, "tip_") == pytest.approx(3.0)


def test_all_groups_of_trials_count():
    found = search([[3, 0, 0, 0]], [[1, 0, 0, 0]])
    assert signal_residual(found, POINT, "current_") == pytest.approx(5.0)


def test_what_nobody_measured_counts_as_noise():
    assert signal_residual(search([[2], [2]], signals=("di",)), POINT, "tip_") == 1.0
