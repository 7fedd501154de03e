"""Prediction interval whose width follows the observer's estimate of its error.

The half width on each axis is q σ. The variance σ² is a sum of non-negative terms: a constant, the
variance D² due to the payload estimate, the squares of bend, of its rate and of the joint's rate,
those of bend and rate times the excess E of the innovation, and the distance that the tip may have
moved since a sample of age a::

    σ² = c₀ + c₁ D² + Σⱼ (c₂ β² + c₃ β̇² + c₄ q̇²)ⱼ + E Σⱼ (c₅ β² + c₆ β̇²)ⱼ + (L a)² Σⱼ (q̇² + β̇²)ⱼ

E is the mean square innovation of the currents above its 75 % quantile. It counts up to the 95 %
quantile, because a violent motion raises the innovation of a correct plant as well. The
coefficients are fitted to errors on trials and payloads left out, and to those of the same trials
with deliberately wrong plants ("disturbed").

q is a quantile of |error| / σ, for each axis and each of four classes of rows (Mondrian conformal
prediction: Vovk et al., Algorithmic Learning in a Random World, 2005, section 4.5): joints that
stand or move, innovation with or without an excess. It is the largest of these:

====================  ===========================================  ==============================
errors                quantile                                     for
====================  ===========================================  ==============================
trials left out       95 % of the rows, every trial with the same  all classes
                      weight, and the level raised by 1/n for n
                      trials [1]_
trials left out       √(t² (1 + 1/n) B² + 1.96² W²): prediction    all classes
                      interval of a normal variable with the root
                      mean square B of the trials' means and the
                      scatter W within trials
each wrong plant      93 % of the rows, every trial with the same  all classes
                      weight
each wrong plant      90 % of the rows in nine of ten trials       joints that move
any                   that of joints that move                     joints that stand
====================  ===========================================  ==============================

The second one is for a deviation that lasts for a whole trial, of which there are only n samples.
Wrong plants count, because a link that is mounted askew or 20 % stiffer shows little in the
signals of the servos: an interval that covers it cannot wait for the innovation. The fourth one is
there since a quantile of all trials together would let one motion be covered less where others are
covered more. The last one: training has few rows of standing joints, mostly of a link at rest that
hardly bends; if the link swings while they stand, a wrong plant errs as much as in motion.

.. [1] Two-layer hierarchical models: Dunn, Wasserman and Ramdas, J. Am. Stat. Assoc. 118, 2023.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.stats import t as student_t

from firmware_py.core.signals import AGE
from models.predictor.onnx_graphs import Array, GraphWriter, evaluate
from models.predictor.polynomials import COVERAGE

STANDING_RAD_S: Final = 0.05
"""Joint rate below which a joint counts as standing [assumed]: 7 % of the study's peak rate."""
LEVER_M: Final = 1.0  # Lever L from the joint to the tip: the link with its base plate
SMALLEST_M: Final = 2e-4
"""Least standard deviation: the noise of a marker (docs/sources.md, "The link")."""
USUAL, LARGEST = 0.75, 0.95
"""Quantiles of the mean square innovation, above and up to which there is an excess [assumed]."""
WRONG_LEVEL: Final = 0.93
"""Quantile of the errors with each kind of wrong plant, over all trials together."""
WRONG_TRIAL_LEVEL: Final = 0.9
"""Quantile of the errors with each kind of wrong plant, within one trial."""
TRIALS: Final = 0.9
"""Fraction of the trials whose quantile counts. Chosen on seven rigs for tuning and on the
default rig with two joints, where the largest of 13 trials halves the range."""
FEWEST_ROWS: Final = 8  # Fewest rows of a class in a trial for a quantile of that trial
HIGHEST_LEVEL: Final = 0.98  # Highest level of the quantile, which rises with few trials
NORMAL: Final = 1.96  # Quantile of the normal distribution for `COVERAGE`
REWEIGHTINGS: Final = 5  # Fits of the variance, each weighted by the previous one
AXES: Final = "xyz"
STANDING, MOVING = [0, 2], [1, 3]
"""Classes of rows by the joints; the second of each has an excess of the innovation."""


def joint_inputs(names: Sequence[str], stem: str) -> list[str]:
    """Inputs of a kind, such as "bend" for `bend_1_rad` and `bend_2_rad`."""
    return [name for name in names if name.startswith(stem) and name[len(stem) + 1].isdigit()]


def write_sums(
    graph: GraphWriter, source: str, names: Sequence[str], groups: Sequence[Sequence[str]]
) -> str:
    """Write the sum of the squares of each group of inputs, shape (1, groups)."""
    square = graph.temporary("Mul", [source, source], "square")
    of_groups = np.array([[float(name in group) for group in groups] for name in names])
    return graph.temporary("MatMul", [square, of_groups], "sums")


@dataclass(frozen=True)
class VarianceTerms:
    """The terms of σ² and the class of a row, as functions of the inputs."""

    names: tuple[str, ...]
    usual: float  # Mean square innovation above which there is an excess, in A²
    largest: float  # Mean square innovation up to which the excess counts, in A²

    def pairs(self) -> list[tuple[str, str]]:
        """Terms as products of two factors, each 1 or a sum of squares by its name."""
        bends, swings, rates = (
            joint_inputs(self.names, stem) for stem in ("bend", "bend_rate", "joint_rate")
        )
        alone = [*(f"tip_{axis}_deviation_m" for axis in AXES), *bends, *swings, *rates]
        return [
            ("1", "1"), *((name, "1") for name in alone),
            *((name, "excess") for name in (*bends, *swings)),
            *((name, AGE.name) for name in (*swings, *rates)),
        ]  # fmt: skip

    def write(self, graph: GraphWriter, source: str) -> str:
        """Write the terms, shape (1, terms)."""
        pairs = self.pairs()
        factors = list(dict.fromkeys(factor for pair in pairs for factor in pair))
        one, excess = factors.index("1"), factors.index("excess")
        groups = [[name] for name in factors]
        groups[one], groups[excess] = [], joint_inputs(self.names, "innovation")
        constants, most = np.zeros(len(factors)), np.full(len(factors), np.finfo(float).max)
        constants[one], constants[excess] = 1.0, -self.usual
        most[excess] = self.largest - self.usual
        sums = write_sums(graph, source, self.names, groups)
        base = graph.temporary("Add", [sums, constants[None]], "factors")
        base = graph.clipped(base, np.zeros(len(factors)), most)
        first, second = (
            graph.columns(base, len(factors), [factors.index(name) for name in side], "factor")
            for side in zip(*pairs, strict=True)
        )
        return graph.temporary("Mul", [first, second], "terms")

    def write_class(self, graph: GraphWriter, source: str) -> str:
        """Write four bits, shape (1, 4), of which one is 1: the class of the row."""
        groups = [joint_inputs(self.names, stem) for stem in ("joint_rate", "innovation")]
        total = write_sums(graph, source, self.names, groups)
        bits = graph.bits(total, np.array([STANDING_RAD_S**2, self.usual]), "moving_excess")
        # 1 - m - e, m - e, e - m, m + e - 1 of the bits m and e; the negative ones become 0.
        signs = np.array([[-1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0]])
        votes = graph.temporary("Gemm", [bits, signs, np.array([[1.0, 0.0, 0.0, -1.0]])], "votes")
        return graph.temporary("Max", [votes, np.zeros((1, 4))], "class")


@dataclass(frozen=True)
class TipInterval:
    """Fitted prediction interval of the tip."""

    terms: VarianceTerms
    weights: Array  # (terms, 3), coefficients of the variance
    quantile: Array  # (4, 3), q: standing, moving, then both with an excess of the innovation

    @classmethod
    def fit(
        cls,
        names: tuple[str, ...],
        calibration: tuple[Array, Array, NDArray[np.intp]],
        disturbed: Sequence[tuple[Array, Array]] = (),
    ) -> TipInterval:
        """Fit on errors of rows that the predictor was not trained on.

        `calibration`: inputs (n, inputs), errors in m (n, 3) and trial of each row. `disturbed`:
        inputs and errors of the same rows with a wrong plant, one entry per kind.
        """
        first, first_m, run = calibration
        columns = [names.index(name) for name in joint_inputs(names, "innovation")]
        squares = (first[:, columns] ** 2).sum(axis=1)
        usual, largest = (float(np.quantile(squares, level)) for level in (USUAL, LARGEST))
        terms = VarianceTerms(names, usual, largest)
        plants = ((first, first_m), *disturbed)
        values = [evaluate(terms.write, inputs) for inputs, _ in plants]
        stacked, error_m = np.vstack(values), np.vstack([error_m for _, error_m in plants])
        weights = np.column_stack(
            [_fit_variance(stacked, error_m[:, axis], terms.pairs(), axis) for axis in range(3)]
        )
        quantile = np.zeros((4, 3))
        for number, (inputs, plant_m) in enumerate(plants):
            score = plant_m / np.sqrt(values[number] @ weights)
            for k, rows in enumerate(evaluate(terms.write_class, inputs).T > 0.5):
                if number == 0:
                    of_plant = _quantiles(score, run, rows)
                else:
                    of_plant = _wrong_quantiles(score, run, rows, by_trial=k in MOVING)
                quantile[k] = np.maximum(quantile[k], of_plant)
        quantile[STANDING] = np.maximum(quantile[STANDING], quantile[MOVING])
        return cls(terms, weights, quantile)

    def half_width(self, inputs: Array) -> Array:
        """Half width of the 95 % interval in m, shape (n, 3)."""
        return evaluate(self.write, inputs)

    def write(self, graph: GraphWriter, source: str) -> str:
        """Write the half width of an input row, shape (1, 3)."""
        terms = self.terms.write(graph, source)
        variance = graph.temporary("MatMul", [terms, self.weights], "variance")
        deviation = graph.temporary("Sqrt", [variance], "deviation")
        of_class = self.terms.write_class(graph, source)
        factor = graph.temporary("MatMul", [of_class, self.quantile], "quantile")
        return graph.temporary("Mul", [deviation, factor], "usual_width")


def _fit_variance(
    terms: Array, error_m: Array, pairs: Sequence[tuple[str, str]], axis: int
) -> Array:
    """Non-negative least squares of squared errors, weighted by their variance."""
    other = {f"tip_{a}_deviation_m" for a in AXES if a != AXES[axis]}
    aged = [k for k, pair in enumerate(pairs) if pair[1] == AGE.name]
    free = [k for k, pair in enumerate(pairs) if k not in aged and pair[0] not in other]
    terms, squares = terms[:, free], error_m**2
    scale = terms.max(axis=0) + 1e-300
    variance = np.full(len(squares), squares.mean() + SMALLEST_M**2)
    for _ in range(REWEIGHTINGS):
        weighted = terms / scale / variance[:, None]
        # The triangular factor has the same sums of squares in few rows.
        gram = weighted.T @ weighted
        root = np.linalg.cholesky(gram + 1e-12 * np.trace(gram) * np.eye(len(gram)))
        solution = nnls(root.T, np.linalg.solve(root, weighted.T @ (squares / variance)))[0]
        variance = np.maximum(terms / scale @ solution, SMALLEST_M**2)
    weights = np.zeros(len(pairs))
    weights[free] = solution / scale
    weights[0] = max(weights[0], SMALLEST_M**2)
    weights[aged] = LEVER_M**2
    return weights


def _quantiles(score: Array, run: NDArray[np.intp], rows: NDArray[np.bool_]) -> Array:
    """Factor q of some rows left out, (3,), from their signed scores."""
    if not rows.any():
        rows = np.ones(len(run), dtype=bool)
    trial, count, weight = _weights(run[rows])
    n = max(len(count), 2)
    level = min(HIGHEST_LEVEL, COVERAGE * (1.0 + 1.0 / n))
    lasting = float(student_t.ppf(0.5 + COVERAGE / 2, n - 1)) * np.sqrt(1 + 1 / n)
    q = []
    for signed in score[rows].T:
        mean = np.bincount(trial, weight * signed) * len(count)
        within = weight @ (signed - mean[trial]) ** 2
        least = np.sqrt(lasting**2 * np.mean(mean**2) + NORMAL**2 * within)
        q.append(max(_weighted_quantile(np.abs(signed), weight, level), least))
    return np.array(q)


def _wrong_quantiles(
    score: Array, run: NDArray[np.intp], rows: NDArray[np.bool_], by_trial: bool
) -> Array:
    """Factor q required for a wrong plant, (3,); 0 if there are no such rows."""
    if not rows.any():
        return np.zeros(3)
    trial, count, weight = _weights(run[rows])
    sizes = np.abs(score[rows])
    q = np.array([_weighted_quantile(size, weight, WRONG_LEVEL) for size in sizes.T])
    long = np.flatnonzero(count >= FEWEST_ROWS)
    if by_trial and len(long):
        each = [np.quantile(sizes[trial == k], WRONG_TRIAL_LEVEL, axis=0) for k in long]
        q = np.maximum(q, np.quantile(each, TRIALS, axis=0))
    return q


def _weights(run: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Trial of each row, rows of each trial, and weights that are the same for every trial."""
    _, trial, count = np.unique(run, return_inverse=True, return_counts=True)
    return trial, count, 1.0 / count[trial] / len(count)


def _weighted_quantile(size: Array, weight: Array, level: float) -> float:
    order = np.argsort(size)
    last = int(np.searchsorted(np.cumsum(weight[order]), level))
    return float(size[order][min(last, len(order) - 1)])
