"""Candidates for the robot's tip predictor, and the interface of yours.

Every candidate is the tip from the signals of the observer and the servos. Two of them are
polynomials of their inputs; the others are the observer's tip with a correction: none, a
polynomial, boosted trees or a perceptron of the signed motion and the payload.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Final, NamedTuple, Protocol, Self, cast

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_text
from firmware_py.core.signals import PAYLOAD, feature_names, tip_names
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import Array, GraphWriter
from models.predictor.polynomials import ClippedPolynomial, predict


class TipPredictor(Protocol):
    """Tip predictor: fitted in Python, written as operators of an ONNX graph.

    Your candidate is one class with these members (docs/predictor/choice.md). Its graph may use
    the operators Gemm, MatMul, Add, Sub, Mul, Max, Min, Greater, Cast, Sqrt and Tanh: CasADi
    imports these, so that the FMU evaluates the same graph.

    Parameters
    ----------
    variant : int
        One of `variants`.

    Attributes
    ----------
    name : str
        Name in tables.
    summary : str
        One phrase for the model card.
    variants : tuple of int
        Settings, such as degrees, among which cross-validation chooses; simplest first.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    variants: ClassVar[tuple[int, ...]]
    variant: int

    def __init__(self, variant: int) -> None: ...

    def fit(self, rows: TipRows) -> Self:
        """Fit on rows of trials.

        Parameters
        ----------
        rows : TipRows
            Inputs of shape (n, `input_names`) in SI units and the measured tip, shape (n, 3), in m.

        Returns
        -------
        Self
            The fitted predictor itself.
        """
        ...

    def predict(self, inputs: Array) -> Array:
        """Predict the tip.

        Parameters
        ----------
        inputs : ndarray, shape (n, `input_names`)
            Input rows in SI units.

        Returns
        -------
        ndarray, shape (n, 3)
            Tip in the world frame in m.
        """
        ...

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """Write the fitted predictor as nodes of an ONNX graph.

        Parameters
        ----------
        graph : GraphWriter
            Receives the nodes.
        source : str
            Name of the input row, shape (1, `input_names`), in SI units.
        output : str
            Name of the result, the tip in m, shape (1, 3).
        """
        ...


def motion_names(dof: int) -> tuple[str, ...]:
    """Signed state of joints and link: angle, its rate, bend and its rate."""
    kinds = ("angle_{j}_rad", "joint_rate_{j}_rad_s", "bend_{j}_rad", "bend_rate_{j}_rad_s")
    return tuple(kind.format(j=j) for kind in kinds for j in range(1, dof + 1))


class _Learned:
    """Function of selected inputs, added to the observer's tip if `corrects`.

    Variant 0 is no function at all. `function` is a class whose `fit(variant, features, target)`
    gives an object with `predict(features)` and `write(graph, features, stem, output)`.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    variants: ClassVar[tuple[int, ...]]
    function: ClassVar[Any] = ClippedPolynomial
    corrects: ClassVar[bool] = True

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def selected(self, dof: int) -> Sequence[str]:
        return (*motion_names(dof), PAYLOAD.name)

    def fit(self, rows: TipRows) -> Self:
        self._columns = rows.columns(self.selected(rows.dof))
        self._base, self._width = rows.columns(tip_names()), len(rows.names)
        if self.variant:
            target_m = rows.tip_m - rows.observer_tip_m if self.corrects else rows.tip_m
            self._fitted = self.function.fit(self.variant, rows.inputs[:, self._columns], target_m)
        return self

    def predict(self, inputs: Array) -> Array:
        base_m: Array = inputs[:, self._base] if self.corrects else np.zeros((len(inputs), 3))
        if self.variant:
            base_m = base_m + self._fitted.predict(inputs[:, self._columns])
        return base_m

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        if not self.variant:
            graph.columns(source, self._width, self._base, "base", output)
            return
        features = graph.columns(source, self._width, self._columns, "features")
        if self.corrects:
            base = graph.columns(source, self._width, self._base, "base")
            correction = self._fitted.write(graph, features, "correction")
            graph.node("Add", [base, correction], output)
        else:
            self._fitted.write(graph, features, "tip", output)


class ObserverTip(_Learned):
    name: ClassVar = "observer"
    summary: ClassVar = "the observer's tip, without a correction"
    variants: ClassVar[tuple[int, ...]] = (0,)


class CorrectedTip(_Learned):
    """Polynomial correction; the variant is its degree."""

    name: ClassVar = "corrected observer"
    summary: ClassVar = "the observer's tip with a polynomial correction of motion and payload"
    variants: ClassVar[tuple[int, ...]] = (0, 1, 2)


class PaperPolynomial(_Learned):
    """The paper's polynomial of angles, currents and DI (equations 2 and 3)."""

    name: ClassVar = "paper polynomial"
    summary: ClassVar = "the paper's polynomial of angles, currents and DI"
    variants: ClassVar[tuple[int, ...]] = (1, 2, 3, 4, 5, 6)
    corrects = False

    def selected(self, dof: int) -> Sequence[str]:
        return feature_names(dof)


class BendPolynomial(_Learned):
    name: ClassVar = "bend polynomial"
    summary: ClassVar = (
        "a polynomial of the joint angles and the observer's signed bend and its rate"
    )
    variants: ClassVar[tuple[int, ...]] = (2, 3, 4)
    corrects = False

    def selected(self, dof: int) -> Sequence[str]:
        return [name for name in motion_names(dof) if not name.startswith("joint_rate")]


TREES, TREE_RATE, SMALLEST_LEAF = 30, 0.15, 40
"""Number of trees, learning rate, and fewest rows in a leaf: 0.7 s of motion. All [assumed]."""
DECIMALS: Final = 9
"""Digits to which inputs are rounded before training, in SI units. Otherwise a split could lie
between values that differ only by rounding, such as those of a joint at rest, and a graph from
another compiler would take the other branch."""

Leaf = tuple[float, list[tuple[int, float, float]]]
"""Value, and comparisons on its path: feature, threshold, and 1 for above or -1 for below."""


class _Trees(NamedTuple):
    """Gradient-boosted trees of each axis of the tip."""

    axes: Sequence[HistGradientBoostingRegressor]

    @classmethod
    def fit(cls, depth: int, features: Array, target_m: Array) -> _Trees:
        axes = [
            HistGradientBoostingRegressor(
                max_iter=TREES, max_depth=depth, learning_rate=TREE_RATE,
                min_samples_leaf=SMALLEST_LEAF, early_stopping=False, random_state=0,
            ).fit(features.round(DECIMALS), target_m[:, axis])
            for axis in range(3)
        ]  # fmt: skip
        for trees in axes:
            for (tree,) in trees._predictors:  # move splits between two rounded values
                tree.nodes["num_threshold"] += 0.5 * 10.0**-DECIMALS
        return cls(axes)

    def predict(self, features: Array) -> Array:
        return np.column_stack([trees.predict(features) for trees in self.axes])

    def write(self, graph: GraphWriter, source: str, stem: str) -> str:
        """Write the sum of the leaves that a row reaches, with all trees side by side.

        A leaf is reached where the signed sum of the comparisons on its path is largest: the
        number of those that must be above.
        """
        leaves = [
            (axis, *leaf)
            for axis, trees in enumerate(self.axes)
            for (tree,) in trees._predictors
            for leaf in _leaves(tree.nodes)
        ]
        depth = max(1, *(len(path) for _, _, path in leaves))
        columns = np.zeros((depth, self.axes[0].n_features_in_, len(leaves)))
        thresholds, signs = np.zeros((2, depth, len(leaves)))
        values = np.zeros((len(leaves), 3))
        for k, (axis, value, path) in enumerate(leaves):
            values[k, axis] = value
            for level, (feature, threshold, sign) in enumerate(path):
                columns[level, feature, k] = 1.0
                thresholds[level, k], signs[level, k] = threshold, sign
        total = ""
        for level in range(depth):
            compared = graph.temporary("MatMul", [source, columns[level]], f"{stem}_compared")
            above = graph.bits(compared, thresholds[level], f"{stem}_above")
            signed = graph.temporary("Mul", [above, signs[level][None]], f"{stem}_signed")
            total = graph.temporary("Add", [total, signed], f"{stem}_sum") if total else signed
        reached = graph.bits(total, (signs > 0).sum(axis=0) - 0.5, f"{stem}_reached")
        start = np.array([np.ravel(trees._baseline_prediction)[0] for trees in self.axes])
        return graph.temporary("Gemm", [reached, values, start], stem)


def _leaves(nodes: Any, k: int = 0) -> list[Leaf]:
    """Leaves of a tree from a node on."""
    node = nodes[k]
    if node["is_leaf"]:
        return [(float(node["value"]), [])]
    feature, threshold = int(node["feature_idx"]), float(node["num_threshold"])
    return [
        (value, [(feature, threshold, sign), *path])
        for side, sign in (("left", -1.0), ("right", 1.0))
        for value, path in _leaves(nodes, int(node[side]))
    ]


class BoostedTrees(_Learned):
    """Correction by boosted trees; the variant is their depth."""

    name: ClassVar = "boosted trees"
    summary: ClassVar = "the observer's tip with a correction by gradient-boosted trees"
    variants: ClassVar[tuple[int, ...]] = (2,)
    function = _Trees


PERCEPTRON_ROWS: Final = 1500
"""Most rows to fit on, equally spaced, because neighbours are nearly equal."""
PERCEPTRON_ITERATIONS: Final = 80
PENALTY: Final = 0.1  # L2 penalty of scikit-learn, against overfitting to few trials [assumed]
CORRECTION_M: Final = 1e-3  # Unit of the fitted correction


class _Net(NamedTuple):
    """One hidden layer of tanh on standardised inputs, which are clipped to the training box."""

    lower: Array
    upper: Array
    pipeline: Pipeline

    @classmethod
    def fit(cls, width: int, features: Array, target_m: Array) -> _Net:
        count = len(features)
        rows = np.linspace(0, count - 1, min(PERCEPTRON_ROWS, count)).round().astype(int)
        net = MLPRegressor(
            hidden_layer_sizes=(width,), activation="tanh", solver="lbfgs", alpha=PENALTY,
            max_iter=PERCEPTRON_ITERATIONS, random_state=0,
        )  # fmt: skip
        pipeline = make_pipeline(StandardScaler(), net)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the limit is a regularisation
            pipeline.fit(features[rows], target_m[rows] / CORRECTION_M)
        return cls(features[rows].min(axis=0), features[rows].max(axis=0), pipeline)

    def predict(self, features: Array) -> Array:
        return CORRECTION_M * predict(self.pipeline, np.clip(features, self.lower, self.upper))

    def write(self, graph: GraphWriter, source: str, stem: str) -> str:
        scaler, net = (step for _, step in self.pipeline.steps)
        (first, second), (bias, last) = net.coefs_, net.intercepts_
        rows = first / scaler.scale_[:, None]
        clipped = graph.clipped(source, self.lower, self.upper)
        hidden = graph.temporary("Gemm", [clipped, rows, bias - scaler.mean_ @ rows], "hidden")
        active = graph.temporary("Tanh", [hidden], "active")
        return graph.temporary("Gemm", [active, CORRECTION_M * second, CORRECTION_M * last], stem)


class Perceptron(_Learned):
    """Correction by a perceptron; the variant is the width of its hidden layer."""

    name: ClassVar = "perceptron"
    summary: ClassVar = "the observer's tip with a correction by a small multi-layer perceptron"
    variants: ClassVar[tuple[int, ...]] = (8,)
    function = _Net


DEFAULT_CANDIDATES: Final[tuple[type[TipPredictor], ...]] = (ObserverTip,)
"""What is trained without a comparison (docs/predictor/choice.md says why)."""
CANDIDATES: Final[tuple[type[TipPredictor], ...]] = (
    ObserverTip, PaperPolynomial, BendPolynomial, CorrectedTip, BoostedTrees, Perceptron,
)  # fmt: skip
"""What `train --compare` compares, simplest first."""

MEMBERS: Final = ("name", "summary", "variants", "fit", "predict", "write")
REMEDY: Final = 'write it as docs/predictor/choice.md shows, "Your predictor"'


def load_candidate(path: Path, others: Sequence[type[TipPredictor]]) -> type[TipPredictor]:
    """Run a Python file and return the one candidate that it defines."""
    text = read_text(path, REMEDY)
    module = ModuleType(f"candidate_{path.stem}")
    sys.modules[module.__name__] = module  # dataclasses look their module up
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except Exception as error:
        cause = f"{type(error).__name__}: {error}"
        raise InputError(path, f"does not run ({cause})", REMEDY) from error
    classes = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and value.__module__ == module.__name__
        and all(hasattr(value, member) for member in MEMBERS)
    ]
    if len(classes) != 1:
        reason = f"has {len(classes)} classes with the members {', '.join(MEMBERS)}, not one"
        raise InputError(path, reason, REMEDY)
    candidate = cast(type[TipPredictor], classes[0])
    if candidate.name in {other.name for other in others}:
        raise InputError(path, f"names its candidate {candidate.name!r} as another is", REMEDY)
    if not candidate.variants:
        raise InputError(path, f"gives {candidate.name!r} no variant", REMEDY)
    return candidate
