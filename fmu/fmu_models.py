"""What the units are: plant, predictor and observer joined into one `StepModel` each.

======== =============================== ====================================================
kind     inputs                          outputs
======== =============================== ====================================================
twin     goals, payload                  the plant's, and the predictor's beside them
observer angles, currents                DI, end effector and payload by the plant observer
predictor angles, currents, DI           end effector, in_range, half width by the polynomial
======== =============================== ====================================================
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeVar

import casadi as ca

from firmware_py.errors import InputError
from firmware_py.signals import IN_RANGE, feature_names, tick_signals, tip_names
from models.learning.onnx_symbolic import predictor_function
from models.plant.plant import Plant, read_plant
from models.plant.step_model import StepModel, Variable, names

Kind = Literal["twin", "predictor", "observer"]
KINDS: Final[tuple[Kind, ...]] = ("twin", "predictor", "observer")
PLANT, PREDICTOR, CARD = "plant.json", "predictor.onnx", "unit.json"
"""Files that a unit carries in its resources: what it was built from, and its kind and dof."""

_T = TypeVar("_T")

DESCRIPTIONS: Final[dict[Kind, str]] = {
    "twin": "Digital twin of the drop-stitch inflatable link with {dof} joint(s): servo and link "
    "in closed loop from the goals, with the polynomial predictor beside the plant.",
    "predictor": "Polynomial predictor of the drop-stitch inflatable link's end effector, "
    "{dof} joint(s), from measured angles, currents and the Deformation Index.",
    "observer": "Observer of the drop-stitch inflatable link with {dof} joint(s): Deformation "
    "Index and payload from measured angles and currents; set the sample at the end of the step.",
}


class Parts(NamedTuple):
    """What a unit is built from.

    Attributes
    ----------
    kind : str
        See the module's table.
    dof : int
        Number of joints.
    plant : Plant or None
        None in a predictor.
    predictor : Path or None
        The ONNX file; None in an observer.
    """

    kind: Kind
    dof: int
    plant: Plant | None
    predictor: Path | None

    def model(self) -> StepModel:
        """Compose the unit's model."""
        if self.kind == "predictor":
            return _predictor(self.dof, _given(self.predictor))
        model = _given(self.plant).step_model(self.dof, self.kind)
        if self.kind == "observer":
            return model
        return _with_predictor(model, self.dof, _given(self.predictor))

    def instead(self, plant: Path | None, bundle: Path | None) -> Parts:
        """Parts with the plant, or the predictor of a bundle, put in the place of their own."""
        return self._replace(
            plant=read_plant(plant) if plant and self.plant else self.plant,
            predictor=bundle / PREDICTOR if bundle and self.predictor else self.predictor,
        )

    def description(self) -> str:
        """One sentence for people."""
        return DESCRIPTIONS[self.kind].format(dof=self.dof)

    def resources(self) -> dict[str, bytes]:
        """Files that the unit carries, so that it can be checked without anything else."""
        files = {CARD: json.dumps({"kind": self.kind, "dof": self.dof}).encode()}
        if self.plant:
            files[PLANT] = json.dumps(self.plant.document(), indent=1).encode()
        if self.predictor:
            files[PREDICTOR] = self.predictor.read_bytes()
        return files


def parts_of(kind: Kind, dof: int, directory: Path, plant: Path | None = None) -> Parts:
    """Find the parts of a unit in a directory: a bundle, or the resources of a unit.

    Parameters
    ----------
    kind, dof
        As in `Parts`.
    directory : Path
        Where predictor.onnx and plant.json lie.
    plant : Path, optional
        Another plant document.

    Raises
    ------
    InputError
        If a file is missing or cannot be used.
    """
    return Parts(
        kind,
        dof,
        None if kind == "predictor" else read_plant(plant or directory / PLANT),
        None if kind == "observer" else directory / PREDICTOR,
    )


def parts_inside(resources: Path) -> Parts | None:
    """Parts that an unpacked unit carries; None where it is not one of ours."""
    try:
        card = json.loads((resources / CARD).read_bytes())
        kind, dof = card["kind"], int(card["dof"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return parts_of(kind, dof, resources) if kind in KINDS else None


def _given(part: _T | None) -> _T:
    assert part is not None, "parts_of gives each kind what it needs"
    return part


def _variables(*names: str) -> tuple[Variable, ...]:
    """Variables of these names as the table of signals has them."""
    table = {s.name: s for s in tick_signals(dof=2)}
    return tuple(Variable(name, table[name].unit, 0.0, table[name].description) for name in names)


_OUTPUTS: Final = _variables(
    *tip_names("predicted_"), IN_RANGE.name, *(f"half_width_{axis}_m" for axis in "xyz")
)
"""What the predictor answers."""


def _answers(path: Path, features: ca.MX) -> ca.MX:
    """Answers of the graph, stacked in the order of `_OUTPUTS`."""
    answers = predictor_function(path)(features=features)
    return ca.vertcat(answers["tip_m"], answers["in_range"], answers["half_width_m"])


def _predictor(dof: int, path: Path) -> StepModel:
    """The predictor alone: no states, the outputs follow the inputs at once."""
    inputs = _variables(*feature_names(dof))
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
        output=ca.Function("output", [x, u, p], [_answers(path, u)]),
        max_substep_s=1.0,
    )


def _with_predictor(plant: StepModel, dof: int, path: Path) -> StepModel:
    """The plant with the predictor's answers to its angles, currents and DI beside its outputs."""
    x, u, p = (
        ca.MX.sym(name, len(group))
        for name, group in (("x", plant.states), ("u", plant.inputs), ("p", plant.parameters))
    )
    missing = set(feature_names(dof)) - set(names(plant.outputs))
    if missing:
        raise InputError(
            f"plant of {plant.name}", f"gives no {sorted(missing)[0]}, which the predictor takes",
            "choose a plant of the link",
        )  # fmt: skip
    y = plant.output(x, u, p)
    rows = [names(plant.outputs).index(name) for name in feature_names(dof)]
    output = ca.Function("output", [x, u, p], [ca.vertcat(y, _answers(path, y[rows]))])
    return replace(plant, outputs=(*plant.outputs, *_OUTPUTS), output=output)
