"""Contract of a tip predictor, which every candidate fulfils."""

from __future__ import annotations

from typing import ClassVar, Protocol, Self, runtime_checkable

from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array
from models.tip.tip_rows import TipRows

__all__ = ["TipPredictor"]


@runtime_checkable
class TipPredictor(Protocol):
    """Tip predictor: fitted with scikit-learn, written as operators of an ONNX graph.

    A candidate of one's own is one class with these members; `models.tip.candidates.candidate_list`
    lists the ones that are compared. Its graph may use the operators Gemm, MatMul, Add, Sub, Mul,
    Max, Min, Greater, Cast, Sqrt and Tanh: CasADi imports these, so that the FMU evaluates the same
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
        Settings, like degrees, among which cross-validation chooses; simplest first.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    variants: ClassVar[tuple[int, ...]]
    variant: int

    def __init__(self, variant: int) -> None: ...

    def fit(self, rows: TipRows) -> Self:
        """Fit on rows; return itself."""
        ...

    def predict(self, inputs: Array) -> Array:
        """Return the tip in m, shape (n, 3), for inputs of shape (n, `input_names`)."""
        ...

    def write(self, graph: GraphWriter, source: str, output: str) -> None:
        """Write the fitted predictor.

        Parameters
        ----------
        graph : GraphWriter
            Receives the nodes.
        source : str
            Input row, shape (1, `input_names`), in SI units.
        output : str
            Name of the result, shape (1, 3).
        """
        ...
