"""Standard errors of linear problems whose errors are alike within each group."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from models.plant.identification.fit import Group, cluster_errors, motion_parts
from models.plant.parameter import Parameter, bound_reached, is_weakly_determined

ROWS = 40
FREE = np.full(3, np.inf)


def drawn_problem(groups, rng):
    """Estimate (its truth is zero), groups and J'J of one draw with correlated errors."""
    phase = np.linspace(0, 2 * np.pi, ROWS, endpoint=False)
    jacobians, errors = [], []
    for load in range(groups):
        dry = np.sign(np.cos(phase))
        jacobians.append(np.column_stack([dry, np.cos(phase), load * dry]))
        shapes = np.column_stack([np.cos(phase), np.sin(phase), np.cos(3 * phase)])
        errors.append(shapes @ rng.normal(size=3) + 0.3 * rng.normal(size=ROWS))
    information = sum(j.T @ j for j in jacobians)
    estimate = np.linalg.solve(
        information, sum(j.T @ e for j, e in zip(jacobians, errors, strict=True))
    )
    held = {
        k: Group(j.T @ j, j.T @ (j @ estimate - e))
        for k, (j, e) in enumerate(zip(jacobians, errors, strict=True))
    }
    return estimate, held, information


@pytest.mark.parametrize("groups", [3, 4, 6])
def test_two_standard_errors_cover_the_truth_where_errors_are_correlated(groups):
    rng = np.random.default_rng(groups)
    covered, naive = [], []
    for _ in range(400):
        estimate, held, information = drawn_problem(groups, rng)
        errors = cluster_errors([held], information, -FREE, FREE)
        covered.append(np.abs(estimate) < 2 * errors)
        naive.append(np.abs(estimate) < 2 * np.sqrt(np.diag(np.linalg.inv(information))))
    assert np.all(np.mean(covered, axis=0) > 0.90)
    assert np.all(np.mean(naive, axis=0) < 0.70)  # the curvature alone


def test_few_groups_leave_the_error_of_the_curvature():
    _, held, information = drawn_problem(4, np.random.default_rng(1))
    two = {k: held[k] for k in (0, 1)}
    errors = cluster_errors([two], information, -FREE, FREE)
    np.testing.assert_allclose(errors**2, np.diag(np.linalg.inv(information)), rtol=1e-9)


def test_a_parameter_at_its_bound_does_not_move_when_a_group_is_left_out():
    _, held, information = drawn_problem(6, np.random.default_rng(2))
    low = np.array([-np.inf, -np.inf, 0.0])
    errors = cluster_errors([held], information, low, FREE)
    fixed = {k: Group(g.information[:2, :2], g.score[:2]) for k, g in held.items()}
    rest = cluster_errors([fixed], information[:2, :2], low[:2], FREE[:2])
    curvature = np.diag(np.linalg.inv(information)) - [
        *np.diag(np.linalg.inv(information[:2, :2])), 0.0,
    ]  # fmt: skip
    np.testing.assert_allclose(errors[:2] ** 2, rest**2 + curvature[:2], rtol=1e-9)
    assert errors[2] ** 2 == pytest.approx(curvature[2])


def test_the_parts_of_a_sinusoid_are_its_quarters():
    angle = np.sin(np.linspace(0, 2 * np.pi, 400, endpoint=False))

    class Rows(SimpleNamespace):
        def __len__(self):
            return len(angle)

    parts = motion_parts(Rows(columns={"angle_1_rad": angle}))
    assert np.bincount(parts).tolist() == pytest.approx([100] * 4, abs=3)
    assert not motion_parts(Rows(columns={})).any()


def test_values_at_a_bound_are_told():
    q = Parameter(name="x", unit="1", value=0.5, low=0.0, high=1.0)
    assert bound_reached(q) is None
    assert bound_reached(msgspec.structs.replace(q, value=1e-9)) == "lower"
    assert bound_reached(msgspec.structs.replace(q, value=1 - 1e-9)) == "upper"


@pytest.mark.parametrize(
    ("prior", "error", "weak"),
    [
        (None, 0.3, True),
        (None, 0.2, False),
        (0.1, 0.2, True),
        (0.1, 0.05, False),
        (0.1, None, False),
    ],
)
def test_a_value_whose_error_is_that_of_its_prior_is_weakly_determined(prior, error, weak):
    q = Parameter(name="share", unit="1", value=0.5, low=0.0, high=1.0, prior_deviation=prior)
    assert is_weakly_determined(msgspec.structs.replace(q, error=error)) == weak
