"""Change of the link: of stiffness and mass alone, never below what the fit cannot tell."""

import numpy as np
import pytest

from models.gap.estimation.link_change import LARGEST_CHANGE, LEAST_CHANGE, link_change
from models.gap.residuals.fit_parameters import FitParameter

PARAMETERS = [
    FitParameter("root_stiffness_1_nm_rad", "nuisance"),
    FitParameter("span_stiffness_1_nm_rad", "nuisance"),
    FitParameter("link_mass_kg", "nuisance"),
    FitParameter("root_damping_1_nm_s_rad", "nuisance"),
    FitParameter("pressure", "trial", trial=0),
    FitParameter("stiffness_softening_share", "effect", effect="stiffness_softening"),
]


def test_a_tenth_in_stiffness_and_mass_counts_one():
    values = np.array([0.1, -0.1, 0.1, 0.0, 0.0, 0.0])
    assert link_change(PARAMETERS, values) == pytest.approx(1.0)
    assert link_change(PARAMETERS, values / 2) == pytest.approx(0.5)


def test_more_than_the_calibration_saw_counts_no_more():
    """A hidden effect may look like a change of the link."""
    values = np.array([0.5, 0.4, 0.0, 0.0, 0.0, 0.0])
    assert link_change(PARAMETERS, values) == LARGEST_CHANGE


def test_damping_variation_and_effects_do_not_count():
    values = np.array([0, 0, 0, 0.5, 3.0, 0.9])
    assert link_change(PARAMETERS, values) == LEAST_CHANGE


def test_a_link_that_is_known_to_be_the_same_has_changed_least_whatever_the_fit_says():
    values = np.array([0.5, 0.4, 0.1, 0.0, 0.0, 0.0])
    assert link_change(PARAMETERS, values, same_link=True) == LEAST_CHANGE


def test_without_a_link_the_measured_amount_holds():
    assert link_change([], np.zeros(0)) == 1.0
