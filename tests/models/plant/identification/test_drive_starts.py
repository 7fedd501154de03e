"""Further starts of the drive's fit: only where they may lead to another valley of the cost."""

from dataclasses import replace

import msgspec
import pytest

from models.plant.identification.identify import (
    ABSENT,
    SHAPE,
    starts_with_alike_servos,
    starts_with_option,
    with_options_of,
)
from models.plant.plant import read_plant


def with_shapes(first, second):
    values = {
        name.format(j=j): value
        for j, shape in ((1, first), (2, second)) for name, value in zip(SHAPE, shape, strict=True)
    }  # fmt: skip
    return read_plant().with_values(values)


def shapes(plant):
    return [tuple(plant.parameters[n.format(j=j)].value for n in SHAPE) for j in (1, 2)]


def test_either_joint_lends_its_goals_shape_to_the_other():
    held, interpolated = (0.0, 0.3, 0.003), (1.0, 1.0, 0.0)
    starts = starts_with_alike_servos(with_shapes(held, interpolated))
    assert [shapes(start) for start in starts] == [2 * [held], 2 * [interpolated]]
    plant, start = with_shapes(held, interpolated), starts[0]
    changed = {n for n, q in start.parameters.items() if q.value != plant.parameters[n].value}
    assert changed == {n.format(j=2) for n in SHAPE}


@pytest.mark.parametrize("second", [(0.0, 1.0, 0.0), (0.25, 0.3, 0.003)])
def test_servos_that_do_alike_need_no_further_start(second):
    assert starts_with_alike_servos(with_shapes((0.0, 0.3, 0.003), second)) == []


def test_a_drive_without_a_shape_of_the_goal_needs_no_further_start():
    plant = read_plant()
    names = {n.format(j=2) for n in SHAPE}
    without = {n: q for n, q in plant.parameters.items() if n not in names}
    assert starts_with_alike_servos(type("Bare", (), {"parameters": without})()) == []


def freed(plant, start):
    before = plant.parameters
    return {n: q.value for n, q in start.parameters.items() if q != before[n]}


def test_a_cascade_is_tried_with_every_option_and_both_joints_get_it():
    plant = read_plant()
    starts = starts_with_option(plant)
    assert [set(freed(plant, s)) for s in starts] == [
        {f"profile_acceleration_{j}_rad_s2" for j in (1, 2)},
        {f"profile_acceleration_{j}_rad_s2" for j in (1, 2)},
        {f"velocity_feedforward_{j}" for j in (1, 2)}
        | {f"position_integral_{j}_per_s2" for j in (1, 2)},
        {f"setpoint_weight_{j}" for j in (1, 2)},
    ]
    for start in starts:
        assert all(start.parameters[n].role == "nuisance" for n in freed(plant, start))


@pytest.mark.parametrize("change", [{"value": 0.2}, {"role": "nuisance"}])
def test_an_option_that_the_plant_has_or_leaves_free_is_not_tried_again(change):
    plant = read_plant()
    q = msgspec.structs.replace(plant.parameters["velocity_feedforward_1"], **change)
    known = replace(plant, parameters={**plant.parameters, q.name: q})
    begins = {n.split("_1")[0] for s in starts_with_option(known) for n in freed(known, s)}
    assert {b for b in begins if "_2" not in b} == {"profile_acceleration", "setpoint_weight"}


def test_a_plant_takes_over_the_options_of_another_and_nothing_else():
    plant = read_plant()
    other = starts_with_option(plant)[-2].with_values({"position_gain_1_per_s": 20.0})
    begins = tuple(ABSENT)
    taken = freed(plant, with_options_of(plant, other))
    assert taken and all(n.startswith(begins) for n in taken)


def test_a_drive_without_options_needs_no_further_start():
    assert starts_with_option(type("Bare", (), {"parameters": {}})()) == []
