"""Choice between the nuisance as refitted beside the named effects and as in the plant as given."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision.acceptance import Acceptance
from models.gap.decision.accepted_fit import refit_is_earned
from models.gap.residuals.partial_residuals import SquaredError
from models.gap.search.held_out_errors import HeldOutErrors
from models.gap.settings import DEFAULT_SETTINGS

ROWS = 100


def errors(**by_signal):
    """Errors by fold; each signal's root mean squares."""
    folds = zip(*by_signal.values(), strict=True)
    return HeldOutErrors(
        tuple(
            {
                signal: SquaredError(ROWS * rms**2, ROWS)
                for signal, rms in zip(by_signal, fold, strict=True)
            }
            for fold in folds
        )
    )


GIVEN = errors(tip=(4.0, 4.0, 4.0), angle=(1.0, 1.0, 1.0))
UNDONE = errors(tip=(2.0, 2.0, 2.0), angle=(1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("tip", "angle", "earned"),
    [
        ((1.0, 1.1, 0.9), (1.0, 1.0, 1.0), True),  # a clear fall everywhere
        ((2.0, 2.0, 2.0), (1.0, 1.0, 1.0), False),  # no fall
        ((1.9, 1.9, 1.9), (1.0, 1.0, 1.0), False),  # by 2.5 % over both signals
        ((2.1, 1.5, 1.5), (1.0, 1.0, 1.0), True),  # over all folds together, not in each
        ((1.0, 1.0, 1.0), (1.04, 1.04, 1.04), False),  # the tip falls, the angle rises
        ((3.0, 3.1, 2.9), (0.9, 0.9, 0.9), False),
    ],
)
def test_a_refit_is_written_only_where_the_error_falls_and_no_signal_pays_for_it(
    tip, angle, earned
):
    assert refit_is_earned(UNDONE, errors(tip=tip, angle=angle), GIVEN, DEFAULT_SETTINGS) is earned


def test_a_refit_may_repair_a_signal_that_the_effect_alone_makes_worse():
    undone = errors(tip=(2.0, 2.0, 2.0), angle=(1.2, 1.2, 1.2))
    refitted = errors(tip=(1.9, 1.8, 1.7), angle=(1.1, 1.0, 1.0))
    assert refit_is_earned(undone, refitted, GIVEN, DEFAULT_SETTINGS)
    assert not refit_is_earned(refitted, undone, GIVEN, DEFAULT_SETTINGS)


def test_a_refused_value_of_an_effect_stays_as_given_beside_an_undone_nuisance(monkeypatch):
    """The time of the link through the play of its mount had been written at its bound."""
    nuisance, refused, strength = np.eye(3, dtype=bool)
    tests = Acceptance.__new__(Acceptance)
    tests.search = SimpleNamespace(free=lambda named: np.ones(3, dtype=bool))
    tests.result = SimpleNamespace(named=["backlash"], after=SimpleNamespace(values=np.ones(3)))
    tests.nuisance, tests.as_given = nuisance, refused
    monkeypatch.setattr(tests, "_written", lambda free: nuisance | refused | strength)
    monkeypatch.setattr(tests, "_refitted", lambda values, free: None)
    monkeypatch.setattr(tests, "_fit", lambda point, free: free)
    assert list(tests._nuisance_undone()) == list(strength)
