"""Interface of a tip predictor, which every candidate implements.

Polynomials of some inputs, whose value is the tip or a correction of the observer's tip.

Polynomial of the observer's signed bend and its rate.

Observer's tip with a polynomial correction.

The observer's own tip, without anything trained on tips.

Polynomial of the paper: angles, currents and Deformation Index.

Your own candidate: a class in a file outside of the project.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import ClassVar, Final, Protocol, Self, cast, runtime_checkable

import numpy as np
from sklearn.pipeline import Pipeline

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_text
from firmware_py.signals import PAYLOAD, feature_names, tip_names
from models.predictor.observed_trials import TipRows
from models.predictor.onnx_graphs import GraphWriter
from models.predictor.polynomials import Array, Polynomial, polynomial_pipeline, predict


@runtime_checkable
class TipPredictor(Protocol):
    """Tip predictor: fitted with scikit-learn, written as operators of an ONNX graph.

    Your own candidate is one class with these members; `models.predictor.learners` lists
    the ones that are compared. Its graph may use the operators Gemm, MatMul, Add, Sub, Mul, Max,
    Min, Greater, Cast, Sqrt and Tanh: CasADi imports these, so that the FMU evaluates the same
    graph.

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


class PolynomialTip:
    """Polynomial of selected inputs, clipped to their training box, added to a base."""

    name: ClassVar[str]
    summary: ClassVar[str]
    variants: ClassVar[tuple[int, ...]]
    corrects: ClassVar[bool]

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def chosen(self, dof: int) -> Sequence[str]:
        """Names of the inputs of the polynomial."""
        raise NotImplementedError

    def fit(self, rows: TipRows) -> Self:
        """See `TipPredictor.fit`."""
        self._columns = rows.columns(self.chosen(rows.dof))
        self._base = rows.columns(tip_names())
        self._width = len(rows.names)
        target_m = rows.tip_m - rows.observer_tip_m if self.corrects else rows.tip_m
        self._pipeline: Pipeline | None = None
        if self.variant:
            features = rows.inputs[:, self._columns]
            self._lower, self._upper = features.min(axis=0), features.max(axis=0)
            self._pipeline = polynomial_pipeline(self.variant).fit(features, target_m)
        return self

    def predict(self, inputs: Array) -> Array:
        """See `TipPredictor.predict`."""
        base_m = inputs[:, self._base] if self.corrects else np.zeros((len(inputs), 3))
        if self._pipeline is None:
            return base_m
        clipped = np.clip(inputs[:, self._columns], self._lower, self._upper)
        return base_m + predict(self._pipeline, clipped)

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """See `TipPredictor.write`."""
        terms = []
        if self.corrects:
            terms.append(graph.columns(source, self._width, self._base, "base"))
        if self._pipeline is not None:
            features = graph.columns(source, self._width, self._columns, "features")
            clipped = graph.clipped(features, self._lower, self._upper)
            name = graph.scope.get_unique_variable_name("polynomial")
            terms.append(graph.polynomial(clipped, Polynomial.of(self._pipeline), "tip", name))
        graph.node("Add" if len(terms) > 1 else "Identity", terms, output)


class BendPolynomial(PolynomialTip):
    name: ClassVar[str] = "bend polynomial"
    summary: ClassVar[str] = (
        "a polynomial of the joint angles and the observer's signed bend and its rate"
    )
    variants: ClassVar[tuple[int, ...]] = (2, 3, 4)
    corrects: ClassVar[bool] = False

    def chosen(self, dof: int) -> Sequence[str]:
        return [name for name in motion_names(dof) if not name.startswith("joint_rate")]


class CorrectedTip(PolynomialTip):
    """Observer's tip with a trained polynomial correction; degree 0 means no correction."""

    name: ClassVar[str] = "corrected observer"
    summary: ClassVar[str] = "the observer's tip with a polynomial correction of motion and payload"
    variants: ClassVar[tuple[int, ...]] = (0, 1, 2)
    corrects: ClassVar[bool] = True

    def chosen(self, dof: int) -> Sequence[str]:
        return (*motion_names(dof), PAYLOAD.name)


class ObserverTip:
    name: ClassVar[str] = "observer"
    summary: ClassVar[str] = "the observer's own tip, without a correction"
    variants: ClassVar[tuple[int, ...]] = (0,)

    def __init__(self, variant: int) -> None:
        self.variant = variant

    def fit(self, rows: TipRows) -> Self:
        """See `TipPredictor.fit`."""
        self._columns, self._width = rows.columns(tip_names()), len(rows.names)
        return self

    def predict(self, inputs: Array) -> Array:
        """See `TipPredictor.predict`."""
        return inputs[:, self._columns]

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """See `TipPredictor.write`."""
        tip = graph.columns(source, self._width, self._columns, "observed")
        graph.node("Identity", [tip], output)


class PaperPolynomial(PolynomialTip):
    """The paper's polynomial of angles, currents and DI (equations 2 and 3)."""

    name: ClassVar[str] = "paper polynomial"
    summary: ClassVar[str] = "the paper's polynomial of angles, currents and DI"
    variants: ClassVar[tuple[int, ...]] = (1, 2, 3, 4, 5, 6)
    corrects: ClassVar[bool] = False

    def chosen(self, dof: int) -> Sequence[str]:
        return feature_names(dof)


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
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
    ]
    whole = [value for value in found if all(hasattr(value, member) for member in MEMBERS)]
    if len(whole) != 1:
        raise InputError(path, f"has {len(whole)} candidates, {_lack(found, whole)}", REMEDY)
    candidate = cast(type[TipPredictor], whole[0])
    if candidate.name in {other.name for other in others}:
        raise InputError(path, f"names its candidate {candidate.name!r} as another is", REMEDY)
    if not candidate.variants:
        raise InputError(path, f"gives {candidate.name!r} no variant", REMEDY)
    return candidate


def _lack(found: Sequence[type], whole: Sequence[type]) -> str:
    """Reason why the classes of a file are not one candidate."""
    if whole:
        return "not one"
    if not found:
        return "no class at all"
    lacking = [member for member in MEMBERS if not hasattr(found[-1], member)]
    return f"{found[-1].__name__} lacks {', '.join(lacking)}"
