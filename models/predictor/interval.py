"""Prediction interval whose width follows the observer's estimate of its own error.

The variance of the error on an axis is a sum of non-negative terms: a constant, the variance due to
the payload estimate, the squares of bend, of its rate and of the joint's rate, those of bend and
rate times the mean square innovation, and the distance that the tip has moved since a sample that
is old::

    σ² = c₀ + c₁ D² + Σⱼ (c₂ β² + c₃ β̇² + c₄ q̇²)ⱼ + E Σⱼ (c₅ β² + c₆ β̇²)ⱼ + (L a)² Σⱼ (q̇² + β̇²)ⱼ

with the excess E of the mean square innovation over its 75 % quantile, which counts up to the 95 %
quantile: a violent motion raises the innovation of a correct plant as well. The coefficients are
fitted to errors on trials and payloads left out, and to those of the same trials with deliberately
wrong plants (disturbed). The half width is q σ, with one q for each of four classes of rows
(Mondrian conformal prediction: Vovk et al., Algorithmic Learning in a Random World, 2005, section
4.5): joints that stand or move, innovation with or without an excess.

q is set for each axis separately. It is the largest of three quantiles of |error| / σ: at 95 % on
the trials left out; at 93 % on each kind of wrong plant; and, for joints that move, the value with
which nine of ten trials reach 90 % with each of them. The target is 90 % on every motion, and a
quantile of all trials together would let one be covered less where others are covered more. A link
that is mounted askew or 20 % stiffer shows little in the signals of the servos, so an interval that
covers it cannot wait for the innovation. Rows of a trial are correlated, so every trial has the
same weight and the level of 95 % rises by 1/n for n trials (two-layer hierarchical models: Dunn,
Wasserman and Ramdas, J. Am. Stat. Assoc. 118, 2023). A deviation that lasts for a whole trial has
only n samples: q is at least √(t² (1 + 1/n) B² + 1.96² W²), the prediction interval of a normal
variable with the root mean square B of the trials' means and the scatter W within trials.

Bound on the innovation of the currents, above which the interval of moving joints is too narrow.

The interval follows the present bend. A plant with a wrong stiffness is out of phase with the link,
and where its own bend passes zero the interval is narrow although the tip is far away. The root
mean square innovation, taken over about a second of motion, is then a multiple of that in the
training motions. Only moving joints are tested: a link that was released leaves as large an
innovation with the right plant, and it persists while the joints stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.stats import t as student_t

from firmware_py.signals import AGE
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import GraphWriter
from models.predictor.polynomials import COVERAGE, Array

STANDING_RAD_S: Final = 0.05
"""Joint rate below which a joint counts as standing [assumed]: 7 % of the study's peak rate."""
LEVER_M: Final = 1.0
"""Lever from the joint to the tip: the link with its base plate."""
SMALLEST_M: Final = 2e-4
"""Least standard deviation: the noise of a marker (docs/sources.md, "The link")."""
USUAL: Final = 0.75
"""Quantile of the mean square innovation above which there is an excess [assumed]."""
LARGEST: Final = 0.95
"""Quantile of the mean square innovation up to which the excess counts [assumed]."""
WRONG_LEVEL: Final = 0.93
"""Quantile of the errors with each kind of wrong plant, over all trials together."""
WRONG_TRIAL_LEVEL: Final = 0.9
"""Quantile of the errors with each kind of wrong plant, within one trial."""
TRIALS: Final = 0.9
"""Fraction of the trials whose own quantile counts. Chosen on seven rigs for tuning and on the
default rig with two joints, where the largest of 13 trials halves the range."""
FEWEST_ROWS: Final = 8
"""Fewest rows of a class in a trial that have a quantile of their own."""
HIGHEST_LEVEL: Final = 0.98
"""Highest level of the quantile, which rises with few trials."""
NORMAL: Final = 1.96
"""Quantile of the normal distribution for `COVERAGE`."""
REWEIGHTINGS: Final = 5
"""Fits of the variance, each weighted by the previous one."""
AXES: Final = "xyz"


@dataclass(frozen=True)
class TipInterval:
    """Fitted prediction interval of the tip."""

    names: tuple[str, ...]
    weights: Array  # (terms, 3), coefficients of the variance
    # (4, 3), q per axis: joints that stand, joints that move, then both with an excess of the
    # innovation
    quantile: Array
    # Mean square innovation above which there is an excess, and up to which it counts, in A²
    innovation: tuple[float, float]

    @classmethod
    def fit(
        cls,
        names: tuple[str, ...],
        calibration: tuple[Array, Array, NDArray[np.intp]],
        disturbed: Sequence[tuple[Array, Array]] = (),
    ) -> TipInterval:
        """Fit on errors of rows that the predictor was not trained on.

        `calibration`: inputs (n, inputs), errors in m (n, 3) and trial of each row. `disturbed`:
        the same rows with a wrong plant, one entry per kind.
        """
        first, first_m, run = calibration
        squares = first**2 @ _marked(names, "innovation")
        usual, largest = (float(np.quantile(squares, level)) for level in (USUAL, LARGEST))
        kinds_of_plant = ((first, first_m), *disturbed)
        terms = [_terms(names, inputs, (usual, largest)) for inputs, _ in kinds_of_plant]
        stacked, error_m = np.vstack(terms), np.vstack([error_m for _, error_m in kinds_of_plant])
        weights = np.column_stack(
            [_fit_variance(stacked, error_m[:, axis], names, axis) for axis in range(3)]
        )
        quantile = np.zeros((4, 3))
        for number, (inputs, own_m) in enumerate(kinds_of_plant):
            score = own_m / np.sqrt(terms[number] @ weights)
            kind = _kinds(names, inputs, usual)
            found = [
                _wrong_quantiles(score, run, kind == k, by_trial=k in _MOVING)
                if number
                else _quantiles(score, run, kind == k)
                for k in range(4)
            ]
            quantile = np.maximum(quantile, found)
        quantile[_STANDING] = np.maximum(quantile[_STANDING], quantile[_MOVING])
        return cls(names, weights, quantile, (usual, largest))

    def half_width(self, inputs: Array) -> Array:
        """Half width of the 95 % interval in m, shape (n, 3)."""
        deviation_m = np.sqrt(_terms(self.names, inputs, self.innovation) @ self.weights)
        return np.asarray(
            deviation_m * self.quantile[_kinds(self.names, inputs, self.innovation[0])]
        )

    def write(self, graph: GraphWriter, source: str) -> str:
        """Write the half width of an input row; returns the name of the result, shape (1, 3)."""
        sums, constants, most = _bases(self.names, self.innovation)
        first, second = _factors(self.names)
        square = graph.temporary("Mul", [source, source], "square")
        base = graph.temporary(
            "Gemm",
            [square, graph.constant("sums", sums), graph.constant("constants", constants)],
            "sum",
        )
        base = graph.clipped(base, np.zeros(most.shape[1]), most[0])
        left = graph.temporary("MatMul", [base, graph.constant("first", first)], "left")
        right = graph.temporary("MatMul", [base, graph.constant("second", second)], "right")
        terms = graph.temporary("Mul", [left, right], "terms")
        variance = graph.temporary(
            "MatMul", [terms, graph.constant("variances", self.weights)], "variance"
        )
        deviation = graph.temporary("Sqrt", [variance], "deviation")
        factor = self._write_factor(graph, square)
        return graph.temporary("Mul", [deviation, factor], "usual_width")

    def _write_factor(self, graph: GraphWriter, square: str) -> str:
        """Write q = q₀ + m (q₁ − q₀) + e (q₂ − q₀) + m e (q₃ − q₂ − q₁ + q₀) of two bits m, e."""
        bits = []
        for stem, bound in (("joint_rate", STANDING_RAD_S**2), ("innovation", self.innovation[0])):
            column = graph.constant(f"{stem}_columns", _marked(self.names, stem)[:, None])
            total = graph.temporary("MatMul", [square, column], stem)
            bits.append(graph.bits(total, np.array([bound]), stem))
        bits.append(graph.temporary("Mul", bits, "both"))
        q0, q1, q2, q3 = self.quantile
        factor = graph.constant("quantile", q0[None])
        for bit, change in zip(bits, (q1 - q0, q2 - q0, q3 - q2 - q1 + q0), strict=True):
            step = graph.temporary("MatMul", [bit, graph.constant("change", change[None])], "step")
            factor = graph.temporary("Add", [factor, step], "factor")
        return factor


def _joints(names: Sequence[str]) -> range:
    return range(1, 3 if "angle_2_rad" in names else 2)


def _bases(names: Sequence[str], innovation: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Sums of squares of inputs, (inputs, bases), constants and largest values, (1, bases) each.

    The bases are: one, D² of each axis, E, a², then β², β̇² and q̇² of each joint.
    """
    groups: list[list[str]] = [[]]
    groups += [[f"tip_{axis}_deviation_m"] for axis in AXES]
    groups += [[f"innovation_{j}_a" for j in _joints(names)], [AGE.name]]
    for kind in ("bend_{j}_rad", "bend_rate_{j}_rad_s", "joint_rate_{j}_rad_s"):
        groups += [[kind.format(j=j)] for j in _joints(names)]
    sums = np.zeros((len(names), len(groups)))
    for column, group in enumerate(groups):
        for name in group:
            sums[names.index(name), column] = 1.0
    constants = np.zeros((1, len(groups)))
    constants[0, 0] = 1.0
    constants[0, _EXCESS] = -innovation[0]
    most = np.full((1, len(groups)), np.finfo(float).max)
    most[0, _EXCESS] = innovation[1] - innovation[0]
    return sums, constants, most


_ONE, _DEVIATION, _EXCESS, _AGE, _FIRST_JOINT = 0, 1, 4, 5, 6


def _pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Bases whose product is a term; the last ones are those of an old sample."""
    count = len(_joints(names))
    bends, swings, rates = (
        [_FIRST_JOINT + kind * count + j for j in range(count)] for kind in range(3)
    )
    pairs = [(_ONE, _ONE), *((_DEVIATION + axis, _ONE) for axis in range(3))]
    pairs += [(base, _ONE) for base in (*bends, *swings, *rates)]
    pairs += [(base, _EXCESS) for base in (*bends, *swings)]
    return [*pairs, *((base, _AGE) for base in (*swings, *rates))]


def _factors(names: Sequence[str]) -> tuple[Array, Array]:
    pairs = _pairs(names)
    first, second = np.zeros((2, _FIRST_JOINT + 3 * len(_joints(names)), len(pairs)))
    for term, (left, right) in enumerate(pairs):
        first[left, term] = second[right, term] = 1.0
    return first, second


def _terms(names: Sequence[str], inputs: Array, innovation: tuple[float, float]) -> Array:
    sums, constants, most = _bases(names, innovation)
    first, second = _factors(names)
    base = np.clip(inputs**2 @ sums + constants, 0.0, most)
    return np.asarray((base @ first) * (base @ second))


def _marked(names: Sequence[str], stem: str) -> Array:
    return np.array([float(name.startswith(stem)) for name in names])


def _kinds(names: Sequence[str], inputs: Array, usual: float) -> NDArray[np.intp]:
    """Class of each row: 0 standing, 1 moving, 2 and 3 the same with an excess."""
    moving = inputs**2 @ _marked(names, "joint_rate") > STANDING_RAD_S**2
    excess = inputs**2 @ _marked(names, "innovation") > usual
    return np.asarray(moving + 2 * excess, dtype=np.intp)


_STANDING: Final = [0, 2]
"""Classes of joints that stand. Training has few rows of them, mostly of a link at rest that hardly
bends; if a link swings while the joints stand, a wrong plant errs as much as in motion. Their q is
therefore no less than that of `_MOVING`."""
_MOVING: Final = [1, 3]
"""Classes of joints that move, in the same order."""


def _fit_variance(terms: Array, error_m: Array, names: Sequence[str], axis: int) -> Array:
    """Non-negative least squares of squared errors, weighted by their own variance."""
    pairs = _pairs(names)
    other = {_DEVIATION + k for k in range(3)} - {_DEVIATION + axis}
    aged = [k for k, pair in enumerate(pairs) if pair[1] == _AGE]
    free = [k for k, (left, _) in enumerate(pairs) if k not in aged and left not in other]
    terms, squares = terms[:, free], error_m**2
    scale = terms.max(axis=0) + 1e-300
    variance = np.full(len(squares), squares.mean() + SMALLEST_M**2)
    for _ in range(REWEIGHTINGS):
        weighted = terms / scale / variance[:, None]
        # The triangular factor has the same sums of squares in few rows.
        gram = weighted.T @ weighted
        root = np.linalg.cholesky(gram + 1e-12 * np.trace(gram) * np.eye(len(gram)))
        found = nnls(root.T, np.linalg.solve(root, weighted.T @ (squares / variance)))[0]
        variance = np.maximum(terms / scale @ found, SMALLEST_M**2)
    weights = np.zeros(len(pairs))
    weights[free] = found / scale
    weights[0] = max(weights[0], SMALLEST_M**2)
    weights[aged] = LEVER_M**2
    return weights


def _quantiles(score: Array, run: NDArray[np.intp], rows: NDArray[np.bool_]) -> Array:
    """Factor q of some rows, (3,), from their signed scores; every trial has the same weight."""
    if not rows.any():
        rows = np.ones(len(run), dtype=bool)
    runs, own = np.unique(run[rows], return_inverse=True)
    count = len(runs)
    weight = 1.0 / np.bincount(own)[own] / count
    seen = max(count, 2)
    level = min(HIGHEST_LEVEL, COVERAGE * (1.0 + 1.0 / seen))
    lasting = float(student_t.ppf(0.5 + COVERAGE / 2, seen - 1)) * np.sqrt(1 + 1 / seen)
    found = []
    for axis in range(3):
        signed = score[rows, axis]
        mean = np.bincount(own, weight * signed) * count
        within = weight @ (signed - mean[own]) ** 2
        least = np.sqrt(lasting**2 * np.mean(mean**2) + NORMAL**2 * within)
        found.append(max(_weighted_quantile(np.abs(signed), weight, level), least))
    return np.array(found)


def _wrong_quantiles(
    score: Array, run: NDArray[np.intp], rows: NDArray[np.bool_], by_trial: bool
) -> Array:
    """Factor q required for a wrong plant, (3,); 0 if there are no such rows."""
    if not rows.any():
        return np.zeros(3)
    own = np.unique(run[rows], return_inverse=True)[1]
    count = np.bincount(own)
    weight = 1.0 / count[own] / len(count)
    sizes = np.abs(score[rows])
    found = [[_weighted_quantile(size, weight, WRONG_LEVEL) for size in sizes.T]]
    if by_trial:
        long = np.flatnonzero(count >= FEWEST_ROWS)
        each = [np.quantile(sizes[own == k], WRONG_TRIAL_LEVEL, axis=0) for k in long]
        found += [np.quantile(each, TRIALS, axis=0)] if each else []
    return np.asarray(np.max(found, axis=0))


def _weighted_quantile(size: Array, weight: Array, level: float) -> float:
    order = np.argsort(size)
    last = int(np.searchsorted(np.cumsum(weight[order]), level))
    return float(size[order][min(last, len(order) - 1)])


FACTOR: Final = 1.5
"""Bound as a multiple of the largest innovation in training rows that move. Chosen on nine rigs for
tuning: 1.25 rejects rows of the right plant, 2 lets errors of 40 mm pass."""
NONE_A: Final = float(np.sqrt(np.finfo(float).max))
"""Bound that nothing exceeds."""


@dataclass(frozen=True)
class InnovationBound:
    """Bound on the innovation of each joint."""

    names: tuple[str, ...]
    bound_a: Array  # (dof,), root mean square innovation above which the interval is too narrow

    @classmethod
    def of(cls, rows: TipRows) -> InnovationBound:
        """Bound from training rows with the right plant; none if no joint moves."""
        squares = rows.inputs**2 @ _sums(rows.names, rows.dof)
        moving = squares[:, -1] > STANDING_RAD_S**2
        if not moving.any():
            return cls(rows.names, np.full(rows.dof, NONE_A))
        return cls(rows.names, FACTOR * np.sqrt(squares[moving, :-1].max(axis=0)))

    def exceeded(self, inputs: Array) -> NDArray[np.bool_]:
        """Where joints move and an innovation exceeds its bound, shape (n,)."""
        above = inputs**2 @ _sums(self.names, len(self.bound_a)) > self._thresholds()
        return np.asarray(above[:, :-1].any(axis=1) & above[:, -1])

    def write(self, graph: GraphWriter, source: str) -> str:
        """Write 1.0 where joints move and an innovation exceeds its bound, else 0.0.

        Returns the name of the result, shape (1, 1).
        """
        dof = len(self.bound_a)
        square = graph.temporary("Mul", [source, source], "bounded")
        sums = graph.constant("bounded_sums", _sums(self.names, dof))
        total = graph.temporary("MatMul", [square, sums], "bounded_total")
        above = graph.bits(total, self._thresholds(), "above")
        # The sum exceeds dof only with the moving bit and at least one other.
        votes = graph.constant("above_votes", np.array([[1.0]] * dof + [[float(dof)]]))
        count = graph.temporary("MatMul", [above, votes], "above_count")
        return graph.bits(count, np.array([dof + 0.5]), "exceeded")

    def _thresholds(self) -> Array:
        return np.append(self.bound_a, STANDING_RAD_S) ** 2


def _sums(names: tuple[str, ...], dof: int) -> Array:
    """Matrix from squared inputs to the squared innovation of each joint and that of all rates."""
    sums = np.zeros((len(names), dof + 1))
    for joint in range(dof):
        sums[names.index(f"innovation_{joint + 1}_a"), joint] = 1.0
        sums[names.index(f"joint_rate_{joint + 1}_rad_s"), dof] = 1.0
    return sums
