"""Candidates for the robot's tip predictor, and the interface of your own one.

Every candidate is the tip from what the observer and the servos tell. Two of them are polynomials
of their inputs; the others are the observer's tip with a correction: none, a polynomial, boosted
trees or a perceptron of the signed motion and the payload.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Final, Protocol, Self, cast, runtime_checkable

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_text
from firmware_py.signals import PAYLOAD, feature_names, tip_names
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import Array, GraphWriter
from models.predictor.polynomials import Polynomial, polynomial_pipeline, predict


@runtime_checkable
class TipPredictor(Protocol):
    """Tip predictor: fitted in Python, written as operators of an ONNX graph.

    Your own candidate is one class with these members (docs/predictor/choice.md). Its graph may use
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


class _Learner:
    """Function of selected inputs, added to the observer's tip if `corrects`.

    Variant 0 is no function at all. A subclass learns the function in `_learn`, evaluates it in
    `_value` and writes it in `_write`; each gets the selected inputs.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    variants: ClassVar[tuple[int, ...]]
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
            self._learn(rows.inputs[:, self._columns], target_m)
        return self

    def predict(self, inputs: Array) -> Array:
        base_m = inputs[:, self._base] if self.corrects else np.zeros((len(inputs), 3))
        return base_m + self._value(inputs[:, self._columns]) if self.variant else base_m

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        if not self.variant:
            graph.columns(source, self._width, self._base, "base", output)
            return
        features = graph.columns(source, self._width, self._columns, "features")
        if self.corrects:
            base = graph.columns(source, self._width, self._base, "base")
            correction = self._write(graph, features, graph.unique("correction"))
            graph.node("Add", [base, correction], output)
        else:
            self._write(graph, features, output)

    def _learn(self, features: Array, target_m: Array) -> None:
        raise NotImplementedError

    def _value(self, features: Array) -> Array:
        raise NotImplementedError

    def _write(self, graph: GraphWriter, features: str, output: str) -> str:
        raise NotImplementedError


class _PolynomialTip(_Learner):
    """Polynomial, its inputs clipped to their training box; the variant is the degree."""

    def _learn(self, features: Array, target_m: Array) -> None:
        self._lower, self._upper = features.min(axis=0), features.max(axis=0)
        self._pipeline = polynomial_pipeline(self.variant).fit(features, target_m)

    def _value(self, features: Array) -> Array:
        return predict(self._pipeline, np.clip(features, self._lower, self._upper))

    def _write(self, graph: GraphWriter, features: str, output: str) -> str:
        clipped = graph.clipped(features, self._lower, self._upper)
        return Polynomial.of(self._pipeline).write(graph, clipped, "tip", output)


class ObserverTip(_PolynomialTip):
    name: ClassVar[str] = "observer"
    summary: ClassVar[str] = "the observer's own tip, without a correction"
    variants: ClassVar[tuple[int, ...]] = (0,)


class CorrectedTip(_PolynomialTip):
    name: ClassVar[str] = "corrected observer"
    summary: ClassVar[str] = "the observer's tip with a polynomial correction of motion and payload"
    variants: ClassVar[tuple[int, ...]] = (0, 1, 2)


class PaperPolynomial(_PolynomialTip):
    """The paper's polynomial of angles, currents and DI (equations 2 and 3)."""

    name: ClassVar[str] = "paper polynomial"
    summary: ClassVar[str] = "the paper's polynomial of angles, currents and DI"
    variants: ClassVar[tuple[int, ...]] = (1, 2, 3, 4, 5, 6)
    corrects: ClassVar[bool] = False

    def selected(self, dof: int) -> Sequence[str]:
        return feature_names(dof)


class BendPolynomial(_PolynomialTip):
    name: ClassVar[str] = "bend polynomial"
    summary: ClassVar[str] = (
        "a polynomial of the joint angles and the observer's signed bend and its rate"
    )
    variants: ClassVar[tuple[int, ...]] = (2, 3, 4)
    corrects: ClassVar[bool] = False

    def selected(self, dof: int) -> Sequence[str]:
        return [name for name in motion_names(dof) if not name.startswith("joint_rate")]


TREES: Final = 30
TREE_RATE: Final = 0.15
SMALLEST_LEAF: Final = 40
"""Fewest rows in a leaf: 0.7 s of motion. All three [assumed]."""
DECIMALS: Final = 9
"""Digits to which inputs are rounded before training, in SI units. Otherwise a split could lie
between values that differ only by rounding, such as those of a joint at rest, and a graph from
another compiler would take the other branch."""


class BoostedTrees(_Learner):
    """Correction of the observer's tip by boosted trees; the variant is their depth.

    A tree is written as the product of its comparisons: each leaf has a factor per level, the
    comparison or its complement, so that one row of leaves represents all trees.
    """

    name: ClassVar[str] = "boosted trees"
    summary: ClassVar[str] = "the observer's tip with a correction by gradient-boosted trees"
    variants: ClassVar[tuple[int, ...]] = (2,)

    def _learn(self, features: Array, target_m: Array) -> None:
        rounded = features.round(DECIMALS)
        self._trees = [
            HistGradientBoostingRegressor(
                max_iter=TREES, max_depth=self.variant, learning_rate=TREE_RATE,
                min_samples_leaf=SMALLEST_LEAF, early_stopping=False, random_state=0,
            ).fit(rounded, target_m[:, axis])
            for axis in range(3)
        ]  # fmt: skip
        for trees in self._trees:
            for (tree,) in trees._predictors:  # move splits between two rounded values
                tree.nodes["num_threshold"] += 0.5 * 10.0**-DECIMALS

    def _value(self, features: Array) -> Array:
        return np.column_stack([trees.predict(features) for trees in self._trees])

    def _write(self, graph: GraphWriter, features: str, output: str) -> str:
        leaves = [
            (axis, *leaf)
            for axis, trees in enumerate(self._trees)
            for tree in trees._predictors
            for leaf in _leaves(tree[0].nodes)
        ]
        values = np.zeros((len(leaves), 3))
        for k, (axis, value, _) in enumerate(leaves):
            values[k, axis] = value
        product = ""
        for level in range(self.variant):
            column = np.zeros((len(self._columns), len(leaves)))
            threshold = np.full(len(leaves), -1.0)  # an absent comparison: 0 is above it
            sign, constant = np.ones(len(leaves)), np.zeros(len(leaves))
            for k, (_, _, path) in enumerate(leaves):
                if level < len(path):
                    feature, bound, right = path[level]
                    column[feature, k], threshold[k] = 1.0, bound
                    sign[k], constant[k] = (1.0, 0.0) if right else (-1.0, 1.0)
            stem = f"level_{level}"
            seen = graph.temporary("MatMul", [features, graph.constant(f"{stem}_of", column)], stem)
            bits = graph.bits(seen, threshold, stem)
            signs = graph.constant(f"{stem}_sign", sign[None])
            signed = graph.temporary("Mul", [bits, signs], f"{stem}_signed")
            constants = graph.constant(f"{stem}_constant", constant[None])
            factor = graph.temporary("Add", [signed, constants], f"{stem}_is")
            product = graph.temporary("Mul", [product, factor], "leaf") if product else factor
        grown = graph.temporary("MatMul", [product, graph.constant("values", values)], "grown")
        start = np.array([np.ravel(trees._baseline_prediction)[0] for trees in self._trees])
        return graph.node("Add", [grown, graph.constant("start", start[None])], output)


def _leaves(nodes: Any) -> list[tuple[float, list[tuple[int, float, bool]]]]:
    """Leaves of a tree: value, and the comparisons on its path (feature, bound, whether above)."""
    found = []

    def walk(k: int, path: list[tuple[int, float, bool]]) -> None:
        node = nodes[k]
        if node["is_leaf"]:
            found.append((float(node["value"]), path))
            return
        feature, bound = int(node["feature_idx"]), float(node["num_threshold"])
        walk(int(node["left"]), [*path, (feature, bound, False)])
        walk(int(node["right"]), [*path, (feature, bound, True)])

    walk(0, [])
    return found


PERCEPTRON_ROWS: Final = 1500
"""Most rows to fit on, equally spaced, because neighbours are nearly equal."""
PERCEPTRON_ITERATIONS: Final = 80
PENALTY: Final = 0.1
"""L2 penalty of scikit-learn, against overfitting to few trials [assumed]."""
CORRECTION_M: Final = 1e-3
"""Unit of the fitted correction."""


class Perceptron(_Learner):
    """Correction of the observer's tip by one hidden layer; the variant is its width."""

    name: ClassVar[str] = "perceptron"
    summary: ClassVar[str] = (
        "the observer's tip with a correction by a small multi-layer perceptron"
    )
    variants: ClassVar[tuple[int, ...]] = (8,)

    def _learn(self, features: Array, target_m: Array) -> None:
        count = len(features)
        rows = np.linspace(0, count - 1, min(PERCEPTRON_ROWS, count)).round().astype(int)
        features, target_m = features[rows], target_m[rows]
        self._lower, self._upper = features.min(axis=0), features.max(axis=0)
        self._offset, self._scale = features.mean(axis=0), features.std(axis=0) + 1e-12
        self._net = MLPRegressor(
            hidden_layer_sizes=(self.variant,), activation="tanh", solver="lbfgs", alpha=PENALTY,
            max_iter=PERCEPTRON_ITERATIONS, random_state=0,
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the limit is a regularisation
            self._net.fit(self._scaled(features), target_m / CORRECTION_M)

    def _scaled(self, features: Array) -> Array:
        clipped = np.clip(features, self._lower, self._upper)
        return np.asarray((clipped - self._offset) / self._scale)

    def _value(self, features: Array) -> Array:
        return np.asarray(CORRECTION_M * self._net.predict(self._scaled(features)))

    def _write(self, graph: GraphWriter, features: str, output: str) -> str:
        (first, second), (bias, last) = self._net.coefs_, self._net.intercepts_
        rows = first / self._scale[:, None]
        scaled = [graph.constant("rows", rows), graph.constant("bias", bias - self._offset @ rows)]
        weights = [
            graph.constant("weights", CORRECTION_M * second),
            graph.constant("constant", CORRECTION_M * last),
        ]
        clipped = graph.clipped(features, self._lower, self._upper)
        hidden = graph.temporary("Gemm", [clipped, *scaled], "hidden")
        active = graph.temporary("Tanh", [hidden], "active")
        return graph.node("Gemm", [active, *weights], output)


DEFAULT_CANDIDATES: Final[tuple[type[TipPredictor], ...]] = (ObserverTip,)
"""What is trained without a comparison (docs/predictor/choice.md says why)."""
CANDIDATES: Final[tuple[type[TipPredictor], ...]] = (
    ObserverTip, PaperPolynomial, BendPolynomial, CorrectedTip, BoostedTrees, Perceptron,
)  # fmt: skip
"""What `train --compare` compares, simplest first."""

MEMBERS: Final = ("name", "summary", "variants", "fit", "predict", "write")
REMEDY: Final = 'write it as docs/predictor/choice.md shows, "A predictor of one\'s own"'


def own_candidate(path: Path, others: Sequence[type[TipPredictor]]) -> type[TipPredictor]:
    """Run a Python file and return the one candidate that it defines."""
    text = read_text(path, REMEDY)
    module = ModuleType(f"own_candidate_{path.stem}")
    sys.modules[module.__name__] = module  # dataclasses look their module up
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except Exception as error:
        cause = f"{type(error).__name__}: {error}"
        raise InputError(path, f"does not run ({cause})", REMEDY) from error
    classes = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
    ]
    lacking = {c: [m for m in MEMBERS if not hasattr(c, m)] for c in classes}
    whole = [c for c, missing in lacking.items() if not missing]
    if len(whole) != 1:
        reason = "not one" if whole else "no class at all"
        if classes and not whole:
            reason = f"{classes[-1].__name__} lacks {', '.join(lacking[classes[-1]])}"
        raise InputError(path, f"has {len(whole)} candidates, {reason}", REMEDY)
    candidate = cast(type[TipPredictor], whole[0])
    if candidate.name in {other.name for other in others}:
        raise InputError(path, f"names its candidate {candidate.name!r} as another is", REMEDY)
    if not candidate.variants:
        raise InputError(path, f"gives {candidate.name!r} no variant", REMEDY)
    return candidate
