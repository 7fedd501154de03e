"""Polynomials: fit, power form for ONNX, and the paper's predictor with its 95 % interval.

Everything is fitted on inputs scaled to the training box: on raw units scikit-learn's least
squares cuts singular values that matter (docs/sources.md, "ONNX").
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import factorial
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures

from models.predictor.onnx_graphs import Array, GraphWriter

Fold = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Row numbers to train on and to test on."""

DEGREES: Final = (1, 2, 3, 4, 5, 6)  # Degrees that are compared (paper, Figs. 12 to 15)
COVERAGE: Final = 0.95  # Nominal coverage of the prediction interval
OVERSAMPLING: Final = 1.3
"""Linear forms per monomial: with more than 1 the weights stay small (docs/sources.md, "ONNX")."""
LEVERAGE_RIDGE: Final = 1e-6
"""Ridge λ of the leverage's normal equation, relative to its mean squares [assumed]. It bounds the
leverage in a direction without training data, like angle 1 less angle 2 of a motion in phase."""
EDGE: Final = 1e-9
"""Fraction by which the training box is wider than its rows: the DI of a link at rest is the
smallest, and the robot computes it with another rounding (1e-14 of it), in every tick before a
motion."""


def polynomial_pipeline(degree: int) -> Pipeline:
    """Unfitted scaling to [-1, 1]^n, monomials up to a total degree, and least squares."""
    return make_pipeline(
        MinMaxScaler(feature_range=(-1.0, 1.0)),
        PolynomialFeatures(degree, include_bias=False),
        LinearRegression(),
    )


def predict(pipeline: Pipeline, features: Array) -> Array:
    """Outputs of a fitted pipeline, (n, outputs), at features (n, inputs)."""
    return np.asarray(pipeline.predict(features), dtype=np.float64)


@dataclass(frozen=True)
class Polynomial:
    """Polynomial in z = scale * x + offset, as read from a fitted pipeline."""

    scale: Array  # (n,), map from features in SI units to the box [-1, 1]^n
    offset: Array
    degree: int
    coefficients: Array  # (monomials, outputs), in the order of `powers`

    @classmethod
    def of(cls, pipeline: Pipeline) -> Polynomial:
        """Read the polynomial from a fitted `polynomial_pipeline`."""
        scaler, monomials, regression = (step for _, step in pipeline.steps)
        coefficients = np.vstack(
            [np.atleast_1d(regression.intercept_), np.atleast_2d(regression.coef_).T]
        )
        return cls(scaler.scale_, scaler.min_, monomials.degree, coefficients)

    @property
    def powers(self) -> NDArray[np.int64]:
        """Exponents, (monomials, n): all up to the degree, the constant first."""
        return _powers(len(self.scale), self.degree)

    def monomials(self, features: Array) -> Array:
        """Values of the monomials at features in SI units, (n, monomials)."""
        z = features * self.scale + self.offset
        return np.asarray(np.prod(z[:, None, :] ** self.powers, axis=2))

    def __call__(self, features: Array) -> Array:
        """Values of the polynomial at features in SI units, (n, outputs)."""
        return self.monomials(features) @ self.coefficients

    def write(self, graph: GraphWriter, source: str, stem: str, output: str | None = None) -> str:
        """Write y = ((x A + b) ** d) C, the power form.

        One Gemm, one to three Mul and one MatMul serve any number of monomials, where skl2onnx
        writes 2 M + 5 nodes for M monomials (docs/sources.md, "ONNX"). The power is taken by
        repeated squaring: Pow is slow, and CasADi broadcasts it wrongly.
        """
        rows, bias, weights = self._power_form()
        base = graph.temporary("Gemm", [source, rows, bias], f"{stem}_forms")
        power, degree = "", self.degree
        while degree:
            if degree & 1:
                power = graph.temporary("Mul", [power, base], f"{stem}_power") if power else base
            degree >>= 1
            if degree:
                base = graph.temporary("Mul", [base, base], f"{stem}_square")
        return graph.node("MatMul", [power, weights], output or graph.unique(stem))

    def _power_form(self) -> tuple[Array, Array, Array]:
        """A (n, forms), b (forms,) and C (forms, outputs) of the power form (Waring decomposition).

        With z0 = 1 in front every monomial has degree d, and (w·z)^d = Σ_α m_α w^α z^α with the
        multinomial coefficients m_α. Comparing coefficients gives m_α Σ_r c_r w_r^α = β_α: M
        equations for the weights of 1.3 M random unit vectors w_r, solved for the least norm in the
        Bombieri scaling (rows divided by √m_α), which keeps rounding near 1e-14.
        """
        powers = self.powers
        exponents = np.column_stack([self.degree - powers.sum(axis=1), powers])
        forms = math.ceil(OVERSAMPLING * len(exponents))
        vectors = np.random.default_rng(0).standard_normal((forms, exponents.shape[1]))
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        root = np.sqrt(factorial(self.degree) / factorial(exponents).prod(axis=1))[:, None]
        matrix = root * np.prod(vectors[None] ** exponents[:, None, :], axis=2)
        weights = np.linalg.lstsq(matrix, self.coefficients / root, rcond=None)[0]
        rows = (vectors[:, 1:] * self.scale).T
        return rows, vectors[:, 0] + vectors[:, 1:] @ self.offset, weights


def _powers(n: int, degree: int) -> NDArray[np.int64]:
    powers = PolynomialFeatures(degree).fit(np.zeros((1, n))).powers_
    return np.asarray(powers, dtype=np.int64)


@dataclass(frozen=True)
class ClippedPolynomial:
    """Polynomial whose inputs are clipped to the training box.

    Without the clip a block of time that holds the only start of a motion is extrapolated, with
    errors of metres.
    """

    pipeline: Pipeline
    lower: Array  # (n,), training box in SI units, wider than the training rows by `EDGE`
    upper: Array

    @classmethod
    def fit(cls, degree: int, features: Array, targets: Array) -> ClippedPolynomial:
        """Fit to `features` (n, inputs) and `targets` (n, outputs)."""
        lower, upper = features.min(axis=0), features.max(axis=0)
        edge = EDGE * np.maximum(np.abs(lower), np.abs(upper))
        pipeline = polynomial_pipeline(degree).fit(features, targets)
        return cls(pipeline, lower - edge, upper + edge)

    def predict(self, features: Array) -> Array:
        """Outputs at the clipped inputs, (n, outputs)."""
        return predict(self.pipeline, np.clip(features, self.lower, self.upper))

    def write(self, graph: GraphWriter, source: str, stem: str, output: str | None = None) -> str:
        """Write the outputs for an input row."""
        clipped = graph.clipped(source, self.lower, self.upper)
        return Polynomial.of(self.pipeline).write(graph, clipped, stem, output)


def held_out_errors(
    degree: int, features: Array, targets: Array, folds: Iterable[Fold]
) -> list[Array]:
    """Error of every row that a fold leaves out, by fold, (test rows, outputs) each."""
    return [
        targets[test]
        - ClippedPolynomial.fit(degree, features[train], targets[train]).predict(features[test])
        for train, test in folds
    ]


@dataclass(frozen=True)
class GuardedPredictor:
    """The paper's polynomial (eq. 2 and 3) with input guard and 95 % prediction interval.

    `in_range` is true if the inputs lie in the training box. The half width is q sqrt(1 + h(x)): h
    is the leverage of the quadratic model on the *unclipped* input, a quartic polynomial whatever
    the predictor's degree (the leverage of a degree-d model would have degree 2 d: 8008 monomials
    at 5 inputs and degree 5), so it grows outside the training data. q is the quantile of the
    out-of-fold residuals divided by the same root, per output: a cross-conformal interval, which
    assumes no distribution (Vovk, Ann. Math. Artif. Intell. 74, 2015).
    """

    polynomial: ClippedPolynomial
    leverage: Polynomial  # Quartic in the scaled inputs, one output
    quantile: Array  # (outputs,), q, in the unit of the outputs

    @classmethod
    def fit(
        cls, degree: int, features: Array, targets: Array, folds: Iterable[Fold]
    ) -> GuardedPredictor:
        """Fit on all rows; calibrate the interval on the rows that each fold leaves out.

        The folds must leave out whole runs, because rows of one run are correlated.
        """
        folds, leverage = list(folds), _leverage(features)
        error = np.vstack(held_out_errors(degree, features, targets, folds))
        tested = features[np.concatenate([test for _, test in folds])]
        score = np.abs(error) / np.sqrt(1.0 + leverage(tested))
        level = min(1.0, COVERAGE * (1.0 + 1.0 / len(score)))
        quantile = np.quantile(score, level, axis=0, method="higher")
        return cls(ClippedPolynomial.fit(degree, features, targets), leverage, quantile)

    def predict(self, features: Array) -> Array:
        """Outputs at the clipped inputs, (n, outputs)."""
        return self.polynomial.predict(features)

    def in_range(self, features: Array) -> NDArray[np.bool_]:
        """Whether every input lies in the training box, bounds included, (n,)."""
        inside = (features >= self.polynomial.lower) & (features <= self.polynomial.upper)
        return np.asarray(inside.all(axis=1))

    def half_width(self, features: Array) -> Array:
        """Half width of the 95 % prediction interval, (n, outputs)."""
        return self.quantile * np.sqrt(1.0 + self.leverage(features))

    def write_graph(self, graph: GraphWriter, source: str) -> None:
        """Write `tip_m`, `in_range` and `half_width_m`; the half width of a NaN is NaN."""
        lower, upper = self.polynomial.lower, self.polynomial.upper
        clipped, inside = graph.inside(source, lower, upper)
        Polynomial.of(self.polynomial.pipeline).write(graph, clipped, "tip", "tip_m")
        graph.bits(inside, np.array([len(lower) - 0.5]), "all_inside", "in_range")
        leverage = self.leverage.write(graph, source, "leverage")
        variance = graph.temporary("Add", [leverage, np.ones((1, 1))], "relative_variance")
        root = graph.temporary("Sqrt", [variance], "relative_width")
        graph.node("MatMul", [root, self.quantile[None]], "half_width_m")


def _leverage(features: Array) -> Polynomial:
    """h(x) = φ(x)ᵀ (ΦᵀΦ + n λ I)⁻¹ φ(x), φ all monomials up to degree 2, as a quartic."""
    quadratic = Polynomial.of(polynomial_pipeline(2).fit(features, features[:, :1]))
    phi, powers = quadratic.monomials(features), quadratic.powers
    ridge = LEVERAGE_RIDGE * len(phi) * np.eye(phi.shape[1])
    inverse = np.linalg.inv(phi.T @ phi + ridge)
    row_of = {tuple(key): row for row, key in enumerate(_powers(powers.shape[1], 4).tolist())}
    products = (powers[:, None] + powers).reshape(inverse.size, -1)
    rows = [row_of[tuple(key)] for key in products.tolist()]
    coefficients = np.bincount(rows, inverse.ravel())[:, None].astype(float)
    return Polynomial(quadratic.scale, quadratic.offset, 4, coefficients)
