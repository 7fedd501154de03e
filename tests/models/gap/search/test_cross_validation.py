"""Cross-validation of an effect: which gains on the trials left out speak for it."""

import numpy as np
import pytest

from models.gap.search import cross_validation


@pytest.mark.parametrize(
    ("gains", "helps"),
    [
        ([251.3, -6.1, -46.7], True),  # softening, which the heaviest of three payloads shows
        ([40.0, 45.0, 50.0], True),
        ([1000.0], True),
        ([0.0, 0.0, 300.0], True),
        ([200.0, -150.0], False),  # fits one payload at the cost of the other
        ([30.0, -20.0, 25.0, -30.0], False),
        ([-1.0], False),
        ([0.0, 0.0], False),
    ],
)
def test_an_effect_must_gain_more_than_it_loses(monkeypatch, gains, helps):
    monkeypatch.setattr(cross_validation, "held_out_gains", lambda *fits: np.array(gains))
    gain, least = cross_validation.held_out_gain(None, None, None)
    assert gain == pytest.approx(sum(gains))
    assert (gain > least) == helps
