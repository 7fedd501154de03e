"""Power form of a polynomial: a sum of powers of linear forms (Waring decomposition)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models.learning.predictors import Array, Polynomial

__all__ = ["power_form"]

OVERSAMPLING: Final = 1.3
"""Linear forms per monomial: with more than 1 the weights stay small (docs/sources.md, "ONNX")."""


def power_form(polynomial: Polynomial) -> tuple[Array, Array, Array]:
    """Write a polynomial as a sum of powers of linear forms of the features in SI units.

    Returns `rows` (n, forms), `bias` (forms,) and `weights` (forms, outputs): y = ((x @ rows +
    bias) ** degree) @ weights.

    With z0 = 1 in front every monomial has degree d, and (w·z)^d = Σ_α m_α w^α z^α with the
    multinomial coefficients m_α. Comparing coefficients gives m_α Σ_r c_r w_r^α = β_α: M equations
    for the weights of 1.3 M random unit vectors w_r, solved for the least norm in the Bombieri
    scaling (rows divided by √m_α), which keeps rounding near 1e-14.
    """
    degree = polynomial.degree
    n = polynomial.exponents.shape[1]
    exponents = _homogeneous(n, degree)
    row_of = {tuple(alpha[1:]): i for i, alpha in enumerate(exponents.tolist())}
    beta = np.zeros((len(exponents), polynomial.coefficients.shape[1]))
    for alpha, value in zip(polynomial.exponents.tolist(), polynomial.coefficients, strict=True):
        beta[row_of[tuple(alpha)]] += value
    forms = math.ceil(OVERSAMPLING * len(exponents))
    vectors = np.random.default_rng(0).standard_normal((forms, n + 1))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    root = np.sqrt([_multinomial(alpha) for alpha in exponents.tolist()])
    matrix = root[:, None] * np.prod(vectors[None] ** exponents[:, None, :], axis=2)
    weights = np.linalg.lstsq(matrix, beta / root[:, None], rcond=None)[0]
    rows = (vectors[:, 1:] * polynomial.scale).T
    bias = vectors[:, 0] + vectors[:, 1:] @ polynomial.offset
    return rows, bias, weights


def _homogeneous(n: int, degree: int) -> NDArray[np.int64]:
    """All exponents of n + 1 variables whose sum is `degree`."""

    def extend(left: int, variables: int) -> list[tuple[int, ...]]:
        if variables == 1:
            return [(left,)]
        return [(k, *rest) for k in range(left + 1) for rest in extend(left - k, variables - 1)]

    return np.array(extend(degree, n + 1), dtype=np.int64)


def _multinomial(alpha: Sequence[int]) -> int:
    return math.factorial(sum(alpha)) // math.prod(math.factorial(k) for k in alpha)
