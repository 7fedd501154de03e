"""Standard errors of linear problems whose errors are alike within each group."""

import numpy as np
import pytest

from models.plant.identification.fit import cluster_errors

ROWS = 40
FREE = np.full(3, np.inf)
NO_PRIOR = np.zeros((3, 3))


def drawn_problem(groups, rng):
    """Estimate (its truth is zero), residual, Jacobian and groups of one draw."""
    phase = np.linspace(0, 2 * np.pi, ROWS, endpoint=False)
    dry = np.sign(np.cos(phase))
    shapes = np.column_stack([np.cos(phase), np.sin(phase), np.cos(3 * phase)])
    jacobian, error = [], []
    for load in range(groups):
        jacobian.append(np.column_stack([dry, np.cos(phase), load * dry]))
        error.append(shapes @ rng.normal(size=3) + 0.3 * rng.normal(size=ROWS))
    jacobian, error = np.concatenate(jacobian), np.concatenate(error)
    estimate = np.linalg.lstsq(jacobian, error)[0]
    return estimate, jacobian @ estimate - error, jacobian, np.repeat(np.arange(groups), ROWS)


@pytest.mark.parametrize("groups", [3, 6])
def test_two_standard_errors_cover_the_truth_where_errors_are_correlated(groups):
    rng = np.random.default_rng(groups)
    covered, naive = [], []
    for _ in range(200):
        estimate, residual, jacobian, labels = drawn_problem(groups, rng)
        errors = cluster_errors(residual, jacobian, NO_PRIOR, [labels], -FREE, FREE)
        covered.append(np.abs(estimate) < 2 * errors)
        curvature = np.linalg.inv(jacobian.T @ jacobian)
        naive.append(np.abs(estimate) < 2 * np.sqrt(np.diag(curvature)))
    assert np.all(np.mean(covered, axis=0) > 0.90)
    assert np.all(np.mean(naive, axis=0) < 0.70)


def test_two_groups_leave_the_error_of_the_curvature():
    _, residual, jacobian, labels = drawn_problem(4, np.random.default_rng(1))
    errors = cluster_errors(residual, jacobian, NO_PRIOR, [labels // 2], -FREE, FREE)
    curvature = np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(errors**2, np.diag(curvature), rtol=1e-9)


def test_a_parameter_at_its_bound_does_not_move_when_a_group_is_left_out():
    _, residual, jacobian, labels = drawn_problem(6, np.random.default_rng(2))
    low = np.array([-np.inf, -np.inf, 0.0])
    errors = cluster_errors(residual, jacobian, NO_PRIOR, [labels], low, FREE)
    others = cluster_errors(
        residual, jacobian[:, :2], NO_PRIOR[:2, :2], [labels], low[:2], FREE[:2]
    )
    information = jacobian.T @ jacobian
    curvature = np.diag(np.linalg.inv(information))
    curvature_of_others = np.diag(np.linalg.inv(information[:2, :2]))
    expected = others**2 + curvature[:2] - curvature_of_others
    np.testing.assert_allclose(errors**2, [*expected, curvature[2]], rtol=1e-9)
