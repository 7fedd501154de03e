"""Polynomials: fit, power form for ONNX, and the paper's predictor with its 95 % interval.

Everything is fitted on inputs scaled to the training box: on raw units scikit-learn's least
squares cuts singular values that matter (docs/sources.md, "ONNX").
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import MinMaxScaler, PolynomialFeatures

from models.predictor.onnx_graphs import Array, GraphWriter

Fold = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Row numbers to train on and to test on."""

DEGREES: Final = (1, 2, 3, 4, 5, 6)
"""Degrees that are compared (paper, Figs. 12 to 15)."""
COVERAGE: Final = 0.95
"""Nominal coverage of the prediction interval."""
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
    """Unfitted pipeline of scaling to [-1, 1]^n, monomials up to a total degree, least squares.

    The constant is the intercept of the regression, not a bias column.
    """
    return make_pipeline(
        MinMaxScaler(feature_range=(-1.0, 1.0)),
        PolynomialFeatures(degree, include_bias=False),
        LinearRegression(),
    )


def predict(pipeline: Pipeline, features: Array) -> Array:
    """Outputs of a fitted pipeline, (n, outputs), at features (n, inputs)."""
    return np.asarray(pipeline.predict(features), dtype=np.float64)


def predict_held_out(degree: int, features: Array, targets: Array, fold: Fold) -> Array:
    """Fit on a fold's training rows and predict its test rows, (test rows, outputs).

    Inputs are clipped to the box of the fold's training rows, as in the deployed predictor. Without
    the clip a block that holds the only start of a motion is extrapolated, with errors of metres.
    """
    train, test = fold
    seen = features[train]
    pipeline = polynomial_pipeline(degree).fit(seen, targets[train])
    return predict(pipeline, np.clip(features[test], seen.min(axis=0), seen.max(axis=0)))


@dataclass(frozen=True)
class Polynomial:
    """Polynomial in z = scale * x + offset, as read from a fitted pipeline."""

    scale: Array  # (n,), map from features in SI units to the box [-1, 1]^n
    offset: Array
    exponents: NDArray[np.int64]  # (monomials, n), one monomial per row; the first is the constant
    coefficients: Array  # (monomials, outputs)

    @property
    def degree(self) -> int:
        return int(self.exponents.sum(axis=1).max())

    @classmethod
    def of(cls, pipeline: Pipeline) -> Polynomial:
        """Read the polynomial from a fitted `polynomial_pipeline`."""
        scaler, monomials, regression = (step for _, step in pipeline.steps)
        powers = np.asarray(monomials.powers_, dtype=np.int64)
        coefficients = np.vstack(
            [np.atleast_1d(regression.intercept_), np.atleast_2d(regression.coef_).T]
        )
        exponents = np.vstack([np.zeros((1, powers.shape[1]), dtype=np.int64), powers])
        return cls(scaler.scale_, scaler.min_, exponents, coefficients)

    def monomials(self, features: Array) -> Array:
        """Values of the monomials at features in SI units, (n, monomials)."""
        z = features * self.scale + self.offset
        return np.asarray(np.prod(z[:, None, :] ** self.exponents, axis=2))

    def __call__(self, features: Array) -> Array:
        """Values of the polynomial at features in SI units, (n, outputs)."""
        return self.monomials(features) @ self.coefficients

    def write(self, graph: GraphWriter, source: str, stem: str, output: str | None = None) -> str:
        """Write y = ((x A + b) ** d) C, the power form.

        One Gemm, one to three Mul and one MatMul serve any number of monomials, where skl2onnx
        writes 2 M + 5 nodes for M monomials (docs/sources.md, "ONNX"). The power is taken by
        repeated squaring: Pow is slow, and CasADi broadcasts it wrongly.
        """
        rows, bias, weights = power_form(self)
        base = graph.temporary(
            "Gemm",
            [source, graph.constant(f"{stem}_rows", rows), graph.constant(f"{stem}_bias", bias)],
            f"{stem}_forms",
        )
        power, degree = "", self.degree
        while degree:
            if degree & 1:
                power = graph.temporary("Mul", [power, base], f"{stem}_power") if power else base
            degree >>= 1
            if degree:
                base = graph.temporary("Mul", [base, base], f"{stem}_square")
        weighted = [power, graph.constant(f"{stem}_weights", weights)]
        return graph.node("MatMul", weighted, output or graph.unique(stem))

    def in_si_units(self) -> dict[tuple[int, ...], Array]:
        """Coefficients of the features in SI units (the paper's β, eq. 2 and 3), (outputs,) by
        exponents.

        They are for display, by total degree. At high degree large coefficients of both signs
        cancel, so a computation must use the scaled form.
        """
        total: dict[tuple[int, ...], Array] = {}
        for exponents, beta in zip(self.exponents, self.coefficients, strict=True):
            # (scale x + offset)^k of each feature, lowest power first, and their outer product
            factors = [
                np.polynomial.polynomial.polypow([offset, scale], int(k))
                for scale, offset, k in zip(self.scale, self.offset, exponents, strict=True)
            ]
            product = factors[0]
            for factor in factors[1:]:
                product = np.multiply.outer(product, factor)
            for key, value in np.ndenumerate(product):
                total[key] = total.get(key, np.zeros_like(beta)) + value * beta
        return dict(sorted(total.items(), key=lambda item: (sum(item[0]), item[0][::-1])))


def power_form(polynomial: Polynomial) -> tuple[Array, Array, Array]:
    """Write a polynomial as a sum of powers of linear forms of the features in SI units.

    Returns `rows` (n, forms), `bias` (forms,) and `weights` (forms, outputs): y = ((x @ rows +
    bias) ** degree) @ weights, a Waring decomposition.

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


@dataclass(frozen=True)
class GuardedPredictor:
    """The paper's polynomial (eq. 2 and 3) with input guard and 95 % prediction interval.

    The polynomial gets inputs clipped to the training box; `in_range` is true if they lay in it.
    The half width is q sqrt(1 + h(x)): h is the leverage of the quadratic model on the *unclipped*
    input, a quartic polynomial whatever the predictor's degree (the leverage of a degree-d model
    would have degree 2 d: 8008 monomials at 5 inputs and degree 5), so it grows outside the
    training data. q is the quantile of the out-of-fold residuals divided by the same root, per
    output: a cross-conformal interval, which assumes no distribution (Vovk, Ann. Math. Artif.
    Intell. 74, 2015).
    """

    pipeline: Pipeline
    lower: Array  # (n,), training box in SI units, wider than the training rows by `EDGE`
    upper: Array
    leverage: Polynomial  # Quartic in the scaled inputs, one output
    quantile: Array  # (outputs,), q, in the unit of the outputs

    @classmethod
    def fit(
        cls, degree: int, features: Array, targets: Array, folds: Iterable[Fold]
    ) -> GuardedPredictor:
        """Fit on all rows; the interval is calibrated on the rows that each fold holds out.

        The folds must hold out whole runs, because rows of one run are correlated.

        Shapes: `features` (n, inputs), `targets` (n, outputs).
        """
        pipeline = polynomial_pipeline(degree).fit(features, targets)
        leverage = _leverage(features)
        scores = []
        for fold in folds:
            test = fold[1]
            residual = np.abs(targets[test] - predict_held_out(degree, features, targets, fold))
            scores.append(residual / np.sqrt(1.0 + leverage(features[test])))
        score = np.concatenate(scores)
        level = min(1.0, COVERAGE * (1.0 + 1.0 / len(score)))
        quantile = np.quantile(score, level, axis=0, method="higher")
        lower, upper = features.min(axis=0), features.max(axis=0)
        edge = EDGE * np.maximum(np.abs(lower), np.abs(upper))
        return cls(pipeline, lower - edge, upper + edge, leverage, quantile)

    def predict(self, features: Array) -> Array:
        """Outputs at the clipped inputs, (n, outputs)."""
        return predict(self.pipeline, np.clip(features, self.lower, self.upper))

    def in_range(self, features: Array) -> NDArray[np.bool_]:
        """Whether every input lies in the training box, bounds included, (n,)."""
        return np.asarray(np.all((features >= self.lower) & (features <= self.upper), axis=1))

    def half_width(self, features: Array) -> Array:
        """Half width of the 95 % prediction interval, (n, outputs)."""
        return self.quantile * np.sqrt(1.0 + self.leverage(features))

    def write_graph(self, graph: GraphWriter, source: str) -> None:
        """Write `tip_m`, `in_range` and `half_width_m`; the half width of a NaN is NaN."""
        clipped, inside = graph.inside(source, self.lower, self.upper)
        Polynomial.of(self.pipeline).write(graph, clipped, "tip", "tip_m")
        graph.bits(inside, np.array([len(self.lower) - 0.5]), "all_inside", "in_range")
        leverage = self.leverage.write(graph, source, "leverage")
        one = graph.constant("one", np.ones((1, 1)))
        variance = graph.temporary("Add", [leverage, one], "relative_variance")
        root = graph.temporary("Sqrt", [variance], "relative_width")
        quantile = graph.constant("quantile", self.quantile[None])
        graph.node("MatMul", [root, quantile], "half_width_m")


def _leverage(features: Array) -> Polynomial:
    """h(x) = φ(x)ᵀ (ΦᵀΦ + n λ I)⁻¹ φ(x), φ all monomials up to degree 2, as a quartic."""
    pipeline = polynomial_pipeline(2).fit(features, features[:, :1])
    quadratic = Polynomial.of(pipeline)
    phi = quadratic.monomials(features)
    ridge = LEVERAGE_RIDGE * len(phi) * np.eye(phi.shape[1])
    inverse = np.linalg.inv(phi.T @ phi + ridge)
    total: dict[tuple[int, ...], float] = {}
    for i, first in enumerate(quadratic.exponents):
        for j, second in enumerate(quadratic.exponents):
            key = tuple(int(k) for k in first + second)
            total[key] = total.get(key, 0.0) + float(inverse[i, j])
    return Polynomial(
        quadratic.scale,
        quadratic.offset,
        np.array(list(total), dtype=np.int64),
        np.array(list(total.values()))[:, None],
    )
