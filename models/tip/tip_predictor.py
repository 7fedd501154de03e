"""Interface of a tip predictor, which every candidate implements."""

from __future__ import annotations

from typing import ClassVar, Protocol, Self, runtime_checkable

from models.learning.graph_writer import GraphWriter
from models.learning.predictors import Array
from models.tip.tip_rows import TipRows

__all__ = ["TipPredictor"]


@runtime_checkable
class TipPredictor(Protocol):
    """Tip predictor: fitted with scikit-learn, written as operators of an ONNX graph.

    Your own candidate is one class with these members; `models.tip.candidates.candidate_list` lists
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
