"""Power form against the monomials of the same polynomial."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from models.predictor.polynomials import Polynomial, power_form

SIZES = st.tuples(st.integers(1, 5), st.integers(1, 6), st.integers(0, 2**32 - 1))


def random_polynomial(n, degree, rng, outputs=3):
    exponents = [e for e in itertools.product(range(degree + 1), repeat=n) if sum(e) <= degree]
    return Polynomial(
        scale=rng.uniform(0.3, 3.0, n),
        offset=rng.uniform(-0.5, 0.5, n),
        exponents=np.array(exponents),
        coefficients=rng.standard_normal((len(exponents), outputs)),
    )


@given(SIZES)
@settings(max_examples=40, deadline=None)
def test_power_form_equals_the_monomials(size):
    n, degree, seed = size
    rng = np.random.default_rng(seed)
    polynomial = random_polynomial(n, degree, rng)
    points = (rng.uniform(-1, 1, (50, n)) - polynomial.offset) / polynomial.scale
    rows, bias, weights = power_form(polynomial)
    expected = polynomial(points)
    difference = ((points @ rows + bias) ** degree) @ weights - expected
    assert np.abs(difference).max() < 1e-11 * max(1.0, np.abs(expected).max())
