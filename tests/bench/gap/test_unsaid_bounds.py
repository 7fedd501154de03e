"""Values at a bound that nothing tells: of the nuisance, and not at it before."""

from types import SimpleNamespace

import pytest

from bench.gap.case_run import unsaid_bounds
from models.gap.residuals.fit_parameters import FitParameter
from models.plant.plant import read_plant

DAMPING = "root_damping_1_nm_s_rad"


def told(named, before, after):
    """Unsaid bounds of a diagnosis that refitted a damping of the link and a hysteresis."""
    plant = read_plant().with_effects("hysteresis")
    turn = "marker_frame_roll_rad"  # the plant has it with the tilt only
    fitted = (
        FitParameter(turn, "nuisance", {turn: 1.0}),
        FitParameter(DAMPING, "nuisance", {DAMPING: 1.0}),
        FitParameter(
            "hysteresis_yield_rad", "effect", {"hysteresis_yield_rad": 1.0}, effect="hysteresis"
        ),
        FitParameter("clock_s", "trial", {DAMPING: 1.0}, trial=0),
    )
    found = SimpleNamespace(
        plant=plant.with_values(before), fit_parameters=fitted, named=named,
        improved=plant.with_effects(*named).with_values(before | after),
    )  # fmt: skip
    return unsaid_bounds(found)


@pytest.mark.parametrize(
    ("parameter", "said"), [(DAMPING, []), ("hysteresis_yield_rad", ["hysteresis"])]
)
def test_a_bound_is_told_of_named_effects_and_of_the_plant_as_given(parameter, said):
    low = read_plant().with_effects("hysteresis").parameters[parameter].low
    assert told((), {}, {}) == []
    assert told(tuple(said), {}, {parameter: low}) == ([] if said else [parameter])
    assert told((), {parameter: low * 1.0001}, {parameter: low}) == []
    assert told(("marker_frame_tilt",), {}, {}) == []
