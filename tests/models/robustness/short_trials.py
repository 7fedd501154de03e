"""Short trials that a twin makes, for the link and for the two example plants."""

from dataclasses import replace

import numpy as np

from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.shared.kinematics import base_rotation
from models.trials.trial import Trial, TrialMeta

EXAMPLES = "models/plant/examples"
PLANTS = {
    "link": None,
    "pendulum": f"{EXAMPLES}/xl330_pendulum.toml",
    "guide": f"{EXAMPLES}/emps.toml",
}
NOISE = {"rad": 1e-4, "a": 0.02, "m": 2e-4, "v": 0.01}
LINK = {
    "pressure_pa": 41300.0, "amplitude_rad": 0.5, "base_offset_m": 0.06, "link_length_m": 0.95,
    "link_width_m": 0.15,
}  # fmt: skip
REST, PERIOD_S = 10, 1.3


def plant_of(kind):
    return read_plant(*([PLANTS[kind]] if PLANTS[kind] else []))


def short_trials(kind, rows=110, payloads=(0.0, 1.0), repeats=2, step_s=0.017, dof=1, seed=0):
    """Trials of a plant that nothing is missing in, with noise in every measured signal."""
    rng, plant = np.random.default_rng(seed), plant_of(kind)
    compiled = CompiledModel(plant.step_model(dof, "twin"))
    result = []
    for payload_kg in payloads:
        for number in range(1, repeats + 1):
            trial = _commanded(kind, rows, payload_kg, number, step_s, dof)
            y = run_trial(compiled, trial)
            columns = dict(trial.columns)
            for k, name in enumerate(names(compiled.model.outputs)):
                if name == "di" or name in columns:
                    continue
                noise = NOISE[name.rsplit("_", 1)[-1]] * rng.standard_normal(len(y))
                if kind == "link" or name in plant.signals:
                    columns[name] = y[:, k] + noise
            trial = replace(trial, columns=columns)
            result.append(_with_markers(trial, rng) if kind == "link" else trial)
    return result


def _commanded(kind, rows, payload_kg, number, step_s, dof):
    time_s = step_s * np.arange(rows)
    wave = np.sin(2 * np.pi * np.maximum(time_s - REST * step_s, 0) / PERIOD_S)
    columns, more = {"time_s": time_s}, {}
    if kind == "link":
        columns |= {f"goal_{j}_rad": 0.5 / j * wave for j in range(1, dof + 1)}
        more = LINK
    elif kind == "pendulum":
        columns |= {"goal_1_rad": 0.8 * wave, "enabled_1": np.ones(rows)}
        columns["supply_1_v"] = np.full(rows, 7.5)
        more["conditions"] = {"mass_kg": 0.5 + payload_kg, "arm_length_m": 0.1, "duty_gain_1": 0.3}
    else:
        columns["command_1_v"] = 2.0 * wave
    meta = TrialMeta(
        dof=dof, payload_kg=payload_kg if kind == "link" else 0.0, trial=number, motion="sinusoid",
        source="test", period_s=PERIOD_S, rest_samples=REST, **more,
    )  # fmt: skip
    return Trial(f"{kind}{dof}_{payload_kg:g}kg_{number}", meta, columns)


def _with_markers(trial, rng):
    """Markers of a straight link whose last row stands at the tip."""
    meta, columns = trial.meta, dict(trial.columns)
    joint = np.column_stack([columns[f"angle_{j}_rad"] for j in range(1, meta.dof + 1)])
    rotation = base_rotation(joint)
    for i in range(16):
        row, corner = divmod(i, 4)
        half = meta.link_width_m / 2
        body = np.array([(half, -half)[corner % 2], (half, -half)[corner // 2], meta.base_offset_m])
        body[2] += meta.link_length_m * (row + 1) / 4
        place = rotation @ body + 1.5e-4 * rng.standard_normal((len(joint), 3))
        columns |= {f"m{i + 1:02d}_{axis}_m": place[:, k] for k, axis in enumerate("xyz")}
    order = [c for c in columns if not c.startswith("di")]
    return replace(trial, columns={c: columns[c] for c in order})
