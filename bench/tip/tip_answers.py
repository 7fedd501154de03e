"""Answers of the deployed predictor and of others to a run, also with a wrong plant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.tip.tip_runs import TipRun
from firmware_py.inference.bundle import POLYNOMIAL, PREDICTOR
from firmware_py.inference.predictor import OnnxPredictor
from models.plant.plant import read_plant
from models.plant.simulation.compiled_model import CompiledModel
from models.plant.step_model import names

Array = NDArray[np.float64]
CONTENDERS = ("deployed", "paper's polynomial", "observer's tip")


class Answer(NamedTuple):
    """Tip, half width and range of each row of a run; the observer's own tip has no interval."""

    tip_m: Array
    half_width_m: Array
    in_range: NDArray[np.bool_]


class Contenders:
    """Predictors of a bundle and its observer."""

    def __init__(self, bundle: Path, dof: int) -> None:
        plant = read_plant(bundle / "plant.json")
        self._observer = CompiledModel(plant.step_model(dof, "observer"))
        self._graphs = {
            "deployed": OnnxPredictor(bundle / PREDICTOR, dof),
            "paper's polynomial": OnnxPredictor(bundle / POLYNOMIAL, dof),
        }

    def wrong_plant(self, what: str, factor: float) -> dict[str, float]:
        """Return the observer's parameters of a kind, all times a factor."""
        found = self._observer.model.parameters
        return {v.name: factor * v.start for v in found if f"_{what}_" in v.name}

    def answers(self, run: TipRun, changes: Mapping[str, float] | None = None) -> dict[str, Answer]:
        model = self._observer.model
        measured = np.column_stack([run.angle_rad, run.current_a])
        y = self._observer.simulate(measured, run.step_s, model.parameter_values(changes))[1:]
        signals = dict(zip(names(model.outputs), y.T, strict=True))
        found = {}
        for name, graph in self._graphs.items():
            wanted = [signals[signal] for signal in graph.wanted]
            rows = np.column_stack(wanted) if wanted else np.zeros((len(y), 0))
            answers = []
            columns = zip(run.angle_rad, run.current_a, signals["di"], rows, strict=True)
            for angle_rad, current_a, di, row in columns:
                told = graph.predict(angle_rad, current_a, float(di), row)
                answers.append((*told.tip_m, *told.half_width_m, told.in_range))
            table = np.array(answers, dtype=np.float64)
            found[name] = Answer(table[:, :3], table[:, 3:6], table[:, 6] > 0.5)
        tip_m = np.column_stack([signals[f"tip_{axis}_m"] for axis in "xyz"])
        unknown = np.full_like(tip_m, np.nan)
        found["observer's tip"] = Answer(tip_m, unknown, np.ones(len(tip_m), dtype=bool))
        return found
