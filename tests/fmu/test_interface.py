from dataclasses import replace

from fmu.interface import interface_of
from models.plant.step_model import names


def test_value_references_number_time_inputs_parameters_outputs(toy):
    interface = interface_of(toy)
    assert [v.reference for v in interface.variables] == list(range(len(interface.variables)))
    assert [v.name for v in interface.variables] == [
        "time",
        *names(toy.inputs),
        *(f"parameters.{name}" for name in names(toy.parameters)),
        *names(toy.outputs),
        *(f"states.{name}" for name in names(toy.states)),
        "der(states.angle_rad)",
        "der(states.rate_rad_s)",
        "indicators.limit_1",
        "indicators.limit_2",
    ]


def test_dependencies_are_those_of_the_equations(toy):
    interface = interface_of(toy)
    by_name = {v.name: v.reference for v in interface.variables}

    def known(table, output):
        return {interface.variables[r].name for r in table[by_name[output]]}

    # read off tests/fmu/toy.py: the tip follows the angle and the length, the mass its input
    assert known(interface.dependencies, "tip_x_m") == {
        "parameters.length_m", "states.angle_rad",
    }  # fmt: skip
    assert known(interface.dependencies, "mass_kg") == {"payload_kg"}
    assert known(interface.dependencies, "steps") == set()
    assert known(interface.dependencies, "der(states.angle_rad)") == {"states.rate_rad_s"}
    assert known(interface.dependencies, "der(states.rate_rad_s)") == {
        "torque_nm", "payload_kg", "parameters.length_m", "parameters.damping_nms_rad",
        "states.angle_rad", "states.rate_rad_s",
    }  # fmt: skip
    assert known(interface.dependencies, "indicators.limit_1") == {"torque_nm"}
    assert known(interface.initial_dependencies, "tip_x_m") == {
        "payload_kg", "parameters.length_m", "parameters.rest_rad",
    }  # fmt: skip
    assert known(interface.initial_dependencies, "torque_filtered_nm") == {"torque_nm"}


def test_states_are_continuous_where_they_have_a_rate(toy):
    interface = interface_of(toy)
    variables = {v.name: v for v in interface.variables}
    assert [v.name for v in interface.continuous_states] == [
        "states.angle_rad", "states.rate_rad_s",
    ]  # fmt: skip
    assert variables["states.count"].variability == "discrete"
    # outputs that follow from discrete states alone change at events only
    assert variables["steps"].variability == "discrete"
    assert variables["tip_x_m"].variability == "continuous"
    assert variables["der(states.rate_rad_s)"].unit == "rad/s2"


def test_a_model_whose_inputs_are_measured_at_the_end_is_sampled(toy):
    interface = interface_of(replace(toy, inputs_at_end=True))
    assert interface.relations.sampled
    assert interface.derivatives == interface.indicators == ()
    assert {v.variability for v in interface.of("output")} == {"discrete"}


def test_a_truth_is_discrete_and_has_its_own_type(toy):
    variables = {v.name: v for v in interface_of(toy).variables}
    assert (variables["in_range"].type, variables["in_range"].variability) == (
        "Boolean", "discrete",
    )  # fmt: skip
    assert variables["tip_x_m"].type == "Float64"
