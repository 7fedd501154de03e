import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.signals import UNIT_OF_SUFFIX
from fmu.si_units import base_exponents


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
