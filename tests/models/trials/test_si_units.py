from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.errors import InputError
from firmware_py.signals import UNIT_OF_SUFFIX
from models.trials.trial import SignalRole
from models.trials.units import TO_SI, base_exponents, check_signal_units


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("1", {}),
        ("N.m", {"kg": 1, "m": 2, "s": -2}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("rad/(N.m)", {"rad": 1, "kg": -1, "m": -2, "s": 2}),
        ("1/s", {"s": -1}),
        ("m/s2", {"m": 1, "s": -2}),
        ("V", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("N/N", {}),
    ],
)
def test_units_are_powers_of_base_units(unit, exponents):
    assert base_exponents(unit) == exponents


@pytest.mark.parametrize("unit", ["", "furlong", "N.", "N..m", "(N.m", "N)m", "m s"])
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


@pytest.mark.parametrize("unit", sorted(set(UNIT_OF_SUFFIX.values()) - {"ns", "degC"}))
def test_every_unit_of_the_signal_table_is_known(unit):
    base_exponents(unit)


def refusal(name, *signal):
    with pytest.raises(InputError) as refused:
        check_signal_units(Path("car.toml"), {name: SignalRole(*signal)})
    return str(refused.value)


def test_a_signal_in_another_unit_than_its_quantity_is_refused():
    said = refusal("encoder", "mm", "measured", "position_1_m")
    assert all(word in said for word in ("car.toml", "encoder", "'mm'", "position_1_m", "'m'"))
    assert "'m'" in refusal("position_1_m", "mm", "measured")
    assert "position_1_m in 'm'" in refusal("x", "rad", "supply", "position_1_m")
    assert "give 'kg'" in refusal("moved", "g", "condition", "load_mass_1_kg")


def test_a_unit_that_is_no_si_unit_is_refused():
    scaled = [unit for unit, (si, _) in TO_SI.items() if si != unit]
    for unit in (*scaled, "Nm", "meter", "°", "", "N.mm/rad", "kW"):
        said = refusal("own", unit, "measured")
        assert f"signal own is given in {unit!r}" in said and "no SI unit" in said


@pytest.mark.parametrize("role", ["goal", "measured", "supply", "condition"])
def test_a_signal_of_any_role_needs_an_si_unit(role):
    assert "no SI unit" in refusal("own", "mm", role)


@pytest.mark.parametrize("unit", sorted(set(UNIT_OF_SUFFIX.values()) - {"ns"} | {"1", "1/rad"}))
def test_every_si_unit_of_the_contract_may_be_that_of_a_signal(unit):
    check_signal_units(Path("car.toml"), {"own": SignalRole(unit, "measured")})
    named = {f"own_{s}": SignalRole(u, "goal") for s, u in UNIT_OF_SUFFIX.items() if u == unit}
    check_signal_units(Path("car.toml"), named)


def test_a_condition_has_the_unit_of_its_parameter_whatever_its_name_ends_in():
    """`_nm_v` is no suffix of the contract, `_v` is one."""
    signals = {"constant": SignalRole("N.m/V", "condition", "force_constant_1_nm_v")}
    check_signal_units(Path("car.toml"), signals)
