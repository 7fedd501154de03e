"""Directional and adjoint derivatives of an FMU, against central differences."""

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from fmu.interface import interface_of
from models.plant.step_model import names

STEP = 1e-6
"""Step of a central difference; its error is of the order of 1e-10."""


def references(archive, wanted):
    table = {v.name: v.valueReference for v in archive.description.modelVariables}
    return [table[name] for name in wanted]


def jacobian(fmu, archive, unknowns, knowns):
    """Column by column."""
    rows, columns = references(archive, unknowns), references(archive, knowns)
    return np.array([fmu.getDirectionalDerivative(rows, [c], [1.0]) for c in columns]).T


CONTINUOUS = ["states.angle_rad", "states.rate_rad_s"]
UNKNOWNS = [
    "tip_x_m", "tip_z_m", "torque_filtered_nm", "mass_kg", "der(states.angle_rad)",
    "der(states.rate_rad_s)", "indicators.limit_1",
]  # fmt: skip
KNOWNS = [
    "torque_nm", "payload_kg", "parameters.length_m", "parameters.damping_nms_rad", *CONTINUOUS,
    "time",
]  # fmt: skip


def relation(toy, x, u, p):
    """Values of `UNKNOWNS` as the interpreted model has them."""
    y = dict(zip(names(toy.outputs), np.asarray(toy.output(x, u, p)).ravel(), strict=True))
    rate = np.asarray(toy.rate(x, u, p)).ravel()
    saturated = interface_of(toy).relations.functions["indicators"]
    limit = np.asarray(saturated(x, u, p)).ravel()[0]
    return np.array([*(y[name] for name in UNKNOWNS[:4]), rate[0], rate[1], limit])


def differences(toy, x, u, p):
    """Central differences by `KNOWNS`: inputs, parameters, continuous states; none by the time."""
    columns = []
    for place in [(1, 0), (1, 1), (2, 0), (2, 1), (0, 0), (0, 1)]:
        sides = []
        for sign in (1, -1):
            z = [np.array(v, dtype=float) for v in (x, u, p)]
            z[place[0]][place[1]] += sign * STEP
            sides.append(relation(toy, *z))
        columns.append((sides[0] - sides[1]) / (2 * STEP))
    return np.array([*columns, np.zeros(len(UNKNOWNS))]).T


def state_of(instance, toy):
    return instance.get([f"states.{name}" for name in names(toy.states)])


def test_directional_derivatives_are_those_of_differences(moving, archive, toy):
    x, p = state_of(moving, toy), toy.parameter_values()
    found = jacobian(moving.fmu, archive, UNKNOWNS, KNOWNS)
    np.testing.assert_allclose(found, differences(toy, x, [1.5, 0.25], p), rtol=1e-8, atol=1e-9)
    direction = np.arange(1.0, len(KNOWNS) + 1)
    rows, columns = references(archive, UNKNOWNS), references(archive, KNOWNS)
    together = moving.fmu.getDirectionalDerivative(rows, columns, list(direction))
    np.testing.assert_allclose(together, found @ direction, rtol=1e-12, atol=1e-12)


def test_adjoint_derivatives_are_the_transpose(moving, archive):
    rows, columns = references(archive, UNKNOWNS), references(archive, KNOWNS)
    if archive.fmi == 2:
        pytest.skip("FMI 2.0 has none")
    found = jacobian(moving.fmu, archive, UNKNOWNS, KNOWNS)
    weights = np.linspace(-1.0, 2.0, len(UNKNOWNS))
    gradient = moving.fmu.getAdjointDerivative(rows, columns, list(weights), len(columns))
    np.testing.assert_allclose(gradient, weights @ found, rtol=1e-12, atol=1e-12)


def test_derivatives_in_initialization_mode_go_through_the_start(archive, toy):
    """The state follows from inputs and parameters there: tip_x = l sin(rest + m/100)."""
    with archive.instance() as instance:
        if archive.fmi == 2:
            instance.fmu.setupExperiment(startTime=0.0)
        instance.fmu.enterInitializationMode()
        knowns = ["payload_kg", "parameters.length_m", "parameters.rest_rad"]
        found = jacobian(instance.fmu, archive, ["tip_x_m", "states.angle_rad"], knowns)
        angle, length = 0.2 + 0.0025, 0.8
        expected = [
            [0.01 * length * np.cos(angle), np.sin(angle), length * np.cos(angle)], [0.01, 0, 1]
        ]  # fmt: skip
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        if archive.fmi == 3:
            rows, columns = references(archive, ["tip_x_m"]), references(archive, knowns)
            gradient = instance.fmu.getAdjointDerivative(rows, columns, [2.0], len(columns))
            np.testing.assert_allclose(gradient, 2 * np.array(expected[0]), rtol=1e-12)
        with pytest.raises(FMICallException):
            jacobian(instance.fmu, archive, ["tip_x_m"], ["states.angle_rad"])
        assert "calculated" in instance.messages[-1]


def test_a_sample_has_derivatives_in_the_event_mode(archive):
    """torque_filtered = (previous + torque) / 2, from toy.py."""
    with archive.instance("ModelExchange") as instance:
        instance.initialize()
        knowns = ["torque_nm", "states.previous_nm", "states.angle_rad"]
        unknowns = ["states.previous_nm", "states.angle_rad"]
        found = jacobian(instance.fmu, archive, unknowns, knowns)
    np.testing.assert_array_equal(found, [[0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])


def test_dependencies_name_every_derivative_that_is_not_zero(moving, archive, toy):
    """Exact in both ways: a known that is not listed has the derivative zero."""
    interface = interface_of(toy)
    table = interface.variables
    knowns = [v.name for v in table if v.causality in ("input", "parameter")] + CONTINUOUS
    unknowns = [
        v.name for v in table if v.reference in interface.dependencies and v.type == "Float64"
    ]
    found = jacobian(moving.fmu, archive, unknowns, knowns) != 0
    place = {v.name: v.reference for v in table}
    listed = [
        [place[known] in interface.dependencies[place[unknown]] for known in knowns]
        for unknown in unknowns
    ]
    np.testing.assert_array_equal(found, listed)


def test_nothing_depends_on_the_size_of_the_example(archive):
    """Not even after the start was differentiated by it."""
    with archive.instance() as instance:
        if archive.fmi == 2:
            instance.fmu.setupExperiment(startTime=0.0)
        instance.fmu.enterInitializationMode()
        rows, columns = (references(archive, [name]) for name in ("tip_x_m", "example.scale"))
        for _ in range(2):
            assert jacobian(instance.fmu, archive, ["tip_x_m"], ["example.scale"]) == [[0.0]]
            if archive.fmi == 3:
                assert instance.fmu.getAdjointDerivative(rows, columns, [1.0], 1) == [0.0]


def test_what_has_no_derivative_is_refused(moving, archive):
    for unknown, known in (
        ("in_range", "torque_nm"), ("states.angle_rad", "torque_nm"),
        ("tip_x_m", "tip_z_m"), ("tip_x_m", "der(states.angle_rad)"),
    ):  # fmt: skip
        logged = len(moving.messages)
        with pytest.raises(FMICallException):
            jacobian(moving.fmu, archive, [unknown], [known])
        assert len(moving.messages) == logged + 1
    with pytest.raises(FMICallException):
        moving.fmu.getDirectionalDerivative(
            references(archive, ["tip_x_m"]), references(archive, ["torque_nm"]), [np.nan]
        )
