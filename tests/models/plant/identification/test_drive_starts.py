"""Further starts of the drive's fit: only where they may lead to another valley of the cost."""

import pytest

from models.plant.identification.drive_starts import SHAPE, starts_with_alike_servos
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
