from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.core.errors import InputError
from firmware_py.core.signals import UNIT_OF_SUFFIX
from models.trials.trial import SignalRole
from models.trials.units import TO_SI, base_exponents, check_signal_units


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("1", {}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("rad/(N.m)", {"rad": 1, "kg": -1, "m": -2, "s": 2}),
        ("1/s", {"s": -1}),
        ("m/s2", {"m": 1, "s": -2}),
        ("V", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("N/(N/(m.s))", {"m": 1, "s": 1}),
    ],
)
def test_units_are_powers_of_base_units(unit, exponents):
    assert base_exponents(unit) == exponents


@pytest.mark.parametrize("unit", ["", "furlong", "N.", "N..m", "(N.m", "N)m", "N(m)", ".m", "m s"])
def test_a_misspelt_unit_is_refused(unit):
    with pytest.raises(ValueError, match="is not a unit"):
        base_exponents(unit)


_UNITS = st.sampled_from(["kg", "m", "s", "A", "rad", "N", "Pa", "W", "V", "N.m", "rad/s"])


@given(_UNITS, _UNITS)
def test_a_quotient_subtracts_what_a_product_adds(first, second):
    product, quotient = base_exponents(f"{first}.({second})"), base_exponents(f"{first}/({second})")
    total = {k: product.get(k, 0) + quotient.get(k, 0) for k in {*product, *quotient}}
    doubled = {k: 2 * v for k, v in base_exponents(first).items()}
    assert {k: v for k, v in total.items() if v} == doubled


@pytest.mark.parametrize(
    ("name", "signal", "words"),
    [
        ("encoder", ("mm", "measured", "position_1_m"), "its quantity position_1_m in 'm'"),
        ("x", ("rad", "supply", "position_1_m"), "position_1_m in 'm'"),
        ("position_1_m", ("mm", "measured"), "its name says 'm'"),
        ("moved", ("g", "condition", "load_mass_1_kg"), "give 'kg'"),
        *(("x", (unit, role), "no SI unit") for unit in ("Nm", "°", "", "N.mm/rad")
          for role in ("goal", "condition")),
        *(("x", (unit, "measured"), "no SI unit") for unit, (si, _) in TO_SI.items() if si != unit),
    ],
)  # fmt: skip
def test_a_signal_in_another_unit_is_refused(name, signal, words):
    with pytest.raises(InputError) as refused:
        check_signal_units(Path("car.toml"), {name: SignalRole(*signal)})
    assert f"car.toml: signal {name} is given in {signal[0]!r}" in str(refused.value)
    assert words in str(refused.value)


def test_every_si_unit_of_the_contract_may_be_that_of_a_signal():
    for suffix, unit in UNIT_OF_SUFFIX.items():
        if unit != "ns":
            signals = {"x": SignalRole(unit, "measured"), f"x_{suffix}": SignalRole(unit, "goal")}
            check_signal_units(Path("car.toml"), signals)
    # A condition has the unit of its parameter, whatever its name ends in: `_nm_v` is no suffix.
    signals = {"constant": SignalRole("N.m/V", "condition", "force_constant_1_nm_v")}
    check_signal_units(Path("car.toml"), signals)
