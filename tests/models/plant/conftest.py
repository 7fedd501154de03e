"""Plants with effects, run compiled."""

import functools
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from firmware_py.link.marker_layout import square_corners_m
from models.commands.new import link_toml
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names
from models.shared.kinematics import base_corners_m, base_rotation
from models.trials.trial import Trial, TrialMeta

STEP_S = 0.017


class Bench:
    """The nominal link with every effect at zero; a model of it is compiled once in a session."""

    step_s = STEP_S

    @functools.cached_property
    def plant(self):
        nominal = read_plant()
        parameters = {n: q for n, q in nominal.parameters.items() if q.role != "effect"}
        plain = replace(nominal, effects=(), parameters=parameters)
        return plain.with_effects(*nominal.applicable())

    @functools.cache  # noqa: B019 (one bench per session)
    def compiled(self, dof=1, kind="twin"):
        return CompiledModel(self.plant.step_model(dof, kind))

    def inputs(self, model, count, goal=None, payload_kg=1.0):
        """Inputs by name; angles and currents of a measured unit are made up."""
        time_s = STEP_S * np.arange(count)
        goal = 0.4 * np.sin(1.44 * time_s) + 0.05 * np.sin(5 * time_s) if goal is None else goal
        known = {"payload_kg": np.full(count, payload_kg)}
        for j, share in ((1, 1.0), (2, 0.7)):
            known |= {f"{what}_{j}_rad": share * goal for what in ("goal", "angle")}
            known[f"current_{j}_a"] = 3.0 * share * goal
        return np.column_stack([known[name] for name in names(model.inputs)])

    def run(self, changes=None, *, dof=1, kind="twin", goal=None, payload_kg=1.0, step_s=STEP_S):
        """Outputs by name, with these parameters."""
        compiled = self.compiled(dof, kind)
        u = self.inputs(compiled.model, 300 if goal is None else len(goal), goal, payload_kg)
        p = compiled.model.parameter_values(changes or {})
        y = compiled.simulate(u, step_s, p)
        return dict(zip(names(compiled.model.outputs), y.T, strict=True))


@pytest.fixture(scope="session")
def bench():
    return Bench()


SHARES = np.diff([2 * s - s**2 for s in (0, 0.25, 0.5, 0.75, 1)])
"""Share of the span's bend that each quarter of a cantilever takes."""


def _with_states(plant, dof):
    """Compile the twin with its states behind its outputs; equal models are compiled once."""
    model = plant.step_model(dof, "twin")
    x, u, p = (model.output.sx_in(k) for k in range(3))
    both = ca.vertcat(model.output(x, u, p), x)
    output = ca.Function("both", [x, u, p], [both])
    return CompiledModel(replace(model, outputs=model.outputs + model.states, output=output))


@pytest.fixture(scope="session")
def synthetic():
    """Trials of a plant itself: noisy, with markers whose edges are strained as its bends say."""

    def make(plant, payload_kg, count=572, rest=60, amplitude_rad=0.52, trial=1, rng=None, dof=1):
        compiled = _with_states(plant, dof)
        moving_s = STEP_S * np.maximum(np.arange(count) - rest, 0)
        goal = -amplitude_rad * np.sin(2 * np.pi / 4.352 * moving_s)
        u = np.column_stack([goal] * dof + [np.full(count, payload_kg)])
        y = compiled.simulate(u[:-1], STEP_S)
        values = dict(zip(names(compiled.model.outputs), y.T, strict=True))
        noise = (lambda size, spread: 0.0) if rng is None else (
            lambda size, spread: rng.normal(0, spread, size))  # fmt: skip
        columns = {"time_s": STEP_S * np.arange(count)}
        for j in range(1, dof + 1):
            columns[f"goal_{j}_rad"] = goal
            columns[f"angle_{j}_rad"] = values[f"angle_{j}_rad"]
            columns[f"current_{j}_a"] = values[f"current_{j}_a"] + noise(count, 0.02)
        tip = np.column_stack([values[f"tip_{a}_m"] for a in "xyz"]) + noise((count, 3), 1e-4)
        columns |= {f"tip_{a}_m": tip[:, k] for k, a in enumerate("xyz")}
        markers = _markers(plant, values, dof) + noise((count, 16, 3), 1.5e-4)
        for i in range(16):
            columns |= {f"m{i + 1:02d}_{a}_m": markers[:, i, k] for k, a in enumerate("xyz")}
        meta = TrialMeta(
            dof=dof, payload_kg=payload_kg, pressure_pa=41300.0, trial=trial, motion="sinusoid",
            source="plant", period_s=4.352, amplitude_rad=amplitude_rad, base_offset_m=0.06,
            link_length_m=0.95, link_width_m=0.15, rest_samples=rest,
        )  # fmt: skip
        name = f"dof{dof}_payload{payload_kg:g}_trial{trial}"
        return Trial(name, meta, {k: np.array(v) for k, v in columns.items()}, Path(f"{name}.csv"))

    return make


def _markers(plant, values, dof):
    """Markers (n, 16, 3) by stacking strained edge segments on the plate at the measured angle.

    Where they stand does not matter to eq. 1, only the lengths between them.
    """
    q = {name: p.value for name, p in plant.parameters.items()}
    angle = np.column_stack([values[f"angle_{j}_rad"] for j in range(1, dof + 1)])
    corners = base_corners_m(angle, q["base_offset_m"], square_corners_m(q["link_width_m"]))
    up = base_rotation(angle)[:, :, 2]
    segment = q["link_length_m"] / 4
    rows, at = [], corners
    for k in range(4):
        strain = np.zeros((len(angle), 4))
        for j in range(1, dof + 1):
            bend = SHARES[k] * values[f"span_bend_{j}_rad"]
            bend = bend + (k == 0) * values[f"root_bend_{j}_rad"]
            side = np.array([1, -1, 1, -1]) if j == 1 else np.array([1, 1, -1, -1])
            strain -= q["edge_gain"] * q["link_width_m"] / 2 / segment * np.outer(bend, side)
        at = at + (segment * (1 + strain))[:, :, None] * up[:, None, :]
        rows.append(at)
    return np.concatenate(rows, axis=1)


@pytest.fixture(scope="session")
def plant_with(tmp_path_factory):
    """Function (drive, load, parameters, effects) -> plant of a file that says so."""

    def plant(drive, load, parameters=(), effects=()):
        path = tmp_path_factory.mktemp("plant") / "plant.toml"
        rows = "\n".join(f"{name} = {value}" for name, value in dict(parameters).items())
        listed = ", ".join(f'{{ name = "{name}" }}' for name in effects)
        path.write_text(
            f'schema = 1\nname = "test"\ndrive = {{ kind = "{drive}" }}\n'
            f'load = {{ kind = "{load}" }}\neffects = [{listed}]\n[parameters]\n{rows}\n'
        )
        return read_plant(path)

    return plant


@pytest.fixture
def plant_of(tmp_path):
    """Function (link) -> plant of its file, as `dropstitch new` writes it."""

    def plant(link):
        path = tmp_path / "link.toml"
        path.write_text(link_toml(link, 1.0, 1.0), encoding="utf-8")
        return read_plant(path)

    return plant
