"""Models of the three kinds of FMU, each composed into one `StepModel`.

========= =============================== ====================================================
kind      inputs                          outputs
========= =============================== ====================================================
twin      goals, payload                  those of the plant and of the predictor
observer  angles, currents, age           those of the plant observer and of the predictor
predictor those of its ONNX graph         tip, in_range, half width of the interval
========= =============================== ====================================================
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, NamedTuple

import casadi as ca

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import read_json
from firmware_py.core.signals import AGE, IN_RANGE, observer_signals, tick_signals, tip_names
from models.plant.document import plant_json
from models.plant.plant import Plant, read_plant
from models.plant.step_model import StepModel, Variable, names
from models.predictor.onnx_graphs import predictor_function, predictor_inputs

Kind = Literal["twin", "predictor", "observer"]
KINDS: Final[tuple[Kind, ...]] = ("twin", "predictor", "observer")
PLANT, PREDICTOR, CARD = "plant.json", "predictor.onnx", "fmu.json"
MODEL_CARD: Final = "MODEL_CARD.md"
"""Files in the resources of an FMU: its plant and predictor, its kind and dof, its model card."""
_MOST_CARD_BYTES: Final = 1000
"""Largest size of a file of kind and dof; the usual size is 30 bytes."""
_MOST_DOF: Final = 2
"""Largest number of joints."""

DESCRIPTIONS: Final[dict[Kind, str]] = {
    "twin": "Digital twin of the drop-stitch inflatable link with {dof} joint(s): servo and link "
    "in closed loop from the goals, with the predictor beside the plant.",
    "predictor": "Predictor of the drop-stitch inflatable link's end effector, "
    "{dof} joint(s), from measured angles and currents and what the observer knows.",
    "observer": "Observer of the drop-stitch inflatable link with {dof} joint(s): Deformation "
    "Index and payload from measured angles and currents, with the predictor beside them; set the "
    "sample at the end of the step.",
}


class FmuParts(NamedTuple):
    """Parts from which an FMU is built."""

    kind: Kind  # See the table of this module
    dof: int
    plant: Plant | None  # None for a predictor
    predictor: Path | None  # ONNX file; may be None beside a plant

    def model(self) -> StepModel:
        if self.kind == "predictor":
            return _predictor(self.dof, self.required_predictor())
        model = self.plant_model()
        return _with_predictor(model, self) if self.predictor else model

    def plant_model(self) -> StepModel:
        """Compose the plant alone, with all inputs that the predictor beside it needs."""
        plant = self.required_plant()
        if self.kind == "twin":
            return plant.step_model(self.dof, "twin")
        wanted = predictor_inputs(self.predictor, self.dof) if self.predictor else ()
        return plant.step_model(self.dof, "observer", with_age=AGE.name in wanted)

    def required_plant(self) -> Plant:
        if self.plant is None:
            raise InputError(f"{self.kind} FMU", "has no plant", "build it with --plant")
        return self.plant

    def required_predictor(self) -> Path:
        if self.predictor is None:
            raise InputError(f"{self.kind} FMU", "has no predictor", "build it from a bundle")
        return self.predictor

    def replaced_by(self, plant: Path | str | None, bundle: Path | str | None) -> FmuParts:
        """Return the parts with another plant, or with the predictor of another bundle."""
        return self._replace(
            plant=read_plant(plant) if plant and self.plant else self.plant,
            predictor=Path(bundle) / PREDICTOR if bundle and self.predictor else self.predictor,
        )

    def description(self) -> str:
        return DESCRIPTIONS[self.kind].format(dof=self.dof)

    def model_card(self) -> str:
        """Return the model card of the predictor's bundle, or ""."""
        card = self.predictor.with_name(MODEL_CARD) if self.predictor else None
        return card.read_text(encoding="utf-8") if card and card.is_file() else ""

    def resources(self) -> dict[str, bytes]:
        """Return the files from which the FMU can be checked, by path in it."""
        files = {CARD: json.dumps({"kind": self.kind, "dof": self.dof}).encode()}
        if self.plant:
            files[PLANT] = plant_json(self.plant.document()).encode()
        if self.predictor:
            files[PREDICTOR] = self.predictor.read_bytes()
        if card := self.model_card():
            files[MODEL_CARD] = card.encode()
        return {f"resources/{name}": data for name, data in files.items()}


def read_parts(
    kind: Kind, dof: int, directory: Path, plant: Plant | Path | None = None
) -> FmuParts:
    """Read the parts of an FMU from a bundle, or from the resources of an FMU.

    `plant`, or its file, replaces the plant.json of that directory.
    """
    predictor: Path | None = directory / PREDICTOR
    if kind == "predictor":
        return FmuParts(kind, dof, None, predictor)
    if not isinstance(plant, Plant):
        plant = read_plant(plant or directory / PLANT)
    return FmuParts(kind, dof, plant, predictor if (directory / PREDICTOR).is_file() else None)


def embedded_parts(resources: Path) -> FmuParts | None:
    """Return the parts in an unpacked FMU; None if `dropstitch` did not build it."""
    try:
        card = read_json(resources / CARD, "build it again", _MOST_CARD_BYTES)
    except InputError:  # no such file, or one of another tool
        return None
    kind, dof = (card.get("kind"), card.get("dof")) if isinstance(card, dict) else (None, None)
    if kind not in KINDS or type(dof) is not int or not 1 <= dof <= _MOST_DOF:
        return None
    return read_parts(kind, dof, resources)


HALF_WIDTH_M: Final = 5e-3
"""Nominal half width of the predictor's interval: 3 to 8 mm on the study's trials [assumed]."""


def _variables(*names: str) -> tuple[Variable, ...]:
    """Variables by name, as the signal table defines them."""
    table = {s.name: s for s in (AGE, *observer_signals(dof=2), *tick_signals(dof=2))}
    return tuple(
        Variable(
            name, table[name].unit, 0.0, table[name].description,
            nominal=HALF_WIDTH_M if name.startswith("half_width_") else 1.0,
        )
        for name in names
    )  # fmt: skip


_OUTPUTS: Final = tuple(
    replace(variable, sampled=True)
    for variable in _variables(
        *tip_names("predicted_"), IN_RANGE.name, *(f"half_width_{axis}_m" for axis in "xyz")
    )
)
"""Outputs of the predictor, which the robot computes once per tick."""


LARGEST_EXPANDED: Final = 2000
"""Largest number of scalar operations up to which a graph is expanded to scalars. Expansion removes
products with zeros and ones; the observer's tip with its interval takes 340 operations. Larger
graphs keep their matrices."""


def _predictions(path: Path, features: Sequence[ca.MX]) -> ca.MX:
    """Outputs of the ONNX graph, stacked in the order of `_OUTPUTS`."""
    function = predictor_function(path)
    expanded = function.expand()
    if expanded.n_instructions() <= LARGEST_EXPANDED:
        function = expanded
    values = function(features=ca.vertcat(*features))
    return ca.vertcat(values["tip_m"], values["in_range"], values["half_width_m"])


def _predictor(dof: int, path: Path) -> StepModel:
    """Model of the predictor alone, without states, with direct feedthrough."""
    inputs = _variables(*predictor_inputs(path, dof))
    x, u, p, h = ca.MX.sym("x", 0), ca.MX.sym("u", len(inputs)), ca.MX.sym("p", 0), ca.MX.sym("h")
    stay = ca.Function("stay", [x, u, p, h], [x])
    return StepModel(
        name=f"predictor_{dof}dof",
        inputs=inputs,
        parameters=(),
        states=(),
        outputs=_OUTPUTS,
        initial=ca.Function("initial", [u, p], [ca.MX(0, 1)]),
        begin=stay,
        flow=stay,
        finish=stay,
        output=ca.Function("output", [x, u, p], [_predictions(path, [u])]),
        max_substep_s=1.0,
    )


def _with_predictor(plant: StepModel, parts: FmuParts) -> StepModel:
    """Add the predictor's outputs, for the motion of the plant, to those of the plant."""
    path = parts.required_predictor()
    x, u, p = (
        ca.MX.sym(name, len(group))
        for name, group in (("x", plant.states), ("u", plant.inputs), ("p", plant.parameters))
    )
    y = plant.output(x, u, p)
    inputs = predictor_inputs(path, parts.dof)
    features = [_of_twin(plant, x, u, y, name) for name in inputs]
    shown = {*names(plant.outputs), *names(plant.inputs)}
    further = {
        name: value
        for name, value in zip(inputs, features, strict=True)
        if name not in shown and not _ERRORS.fullmatch(name)
    }
    rows = ca.vertcat(y, *further.values(), _predictions(path, features))
    predicted = [
        replace(v, description=f"{v.description}, {_OF_A_TWIN}")
        if parts.kind == "twin" and v.name != IN_RANGE.name
        else v
        for v in _OUTPUTS
    ]
    outputs = (*plant.outputs, *_variables(*further), *predicted)
    return replace(plant, outputs=outputs, output=ca.Function("output", [x, u, p], [rows]))


_ERRORS: Final = re.compile(r"innovation_\d_a|tip_[xyz]_deviation_m|age_s")
"""Inputs of a predictor about the observer's estimation error, which is zero for a twin."""

_OF_A_TWIN: Final = "from the twin's signals, as of an observer without error"
"""What the predictor in a twin computes its outputs from."""


def _of_twin(plant: StepModel, x: ca.MX, u: ca.MX, y: ca.MX, name: str) -> ca.MX:
    """Input of the predictor, computed from a twin without estimation error."""
    for group, values in ((plant.outputs, y), (plant.inputs, u)):
        if name in names(group):
            return values[names(group).index(name)]
    if _ERRORS.fullmatch(name):
        return ca.MX(0)
    # The bend of the link is the sum over its hinges; the rate of a joint is a state of the drive.
    states = [k for k, s in enumerate(names(plant.states)) if s == name or s.endswith(f"_{name}")]
    if not states:
        raise InputError(
            f"plant of {plant.name}", f"has no output {name}, which the predictor needs",
            "choose a plant of the link",
        )  # fmt: skip
    return sum((x[k] for k in states), start=ca.MX(0))
