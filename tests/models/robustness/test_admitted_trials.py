"""Every trial that the contract admits (docs/trials.md) is used, or refused in one sentence."""

import functools
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from dropstitch.__main__ import main
from models.gap.estimation import fitted_floor, gauss_newton, nuisance_fit
from models.gap.residuals import localisation
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.search import effect_search, far_strengths
from models.plant.identification import identify as identification
from models.plant.identification import noise_floor
from models.plant.plant import NOMINAL, read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.trials.files import write_trial
from models.trials.recordings.series import marker_columns
from models.trials.trial import SignalRole, Trial, TrialMeta
from tests.models.made_trials import rigid_markers_m, with_columns, with_conditions

pytestmark = pytest.mark.slow

PLANTS = {
    "link": NOMINAL,
    "pendulum": NOMINAL.parent / "examples" / "xl330_pendulum.toml",
    "guide": NOMINAL.parent / "examples" / "emps.toml",
}
NOISE = {"rad": 1e-4, "a": 0.02, "m": 2e-4, "v": 0.01}
ROWS, REST, STEP_S, PERIOD_S = 110, 10, 0.017, 1.3


@functools.cache
def made(kind):
    """Trials of two payloads, each repeated, with noise; nothing is missing in them."""
    rng, plant = np.random.default_rng(0), read_plant(PLANTS[kind])
    compiled = CompiledModel(plant.step_model(1, "twin"))
    result = []
    for payload_kg in (0.0, 1.0):
        for number in (1, 2):
            trial = _commanded(kind, payload_kg, number)
            y = run_trial(compiled, trial)
            columns = dict(trial.columns)
            for k, name in enumerate(names(compiled.model.outputs)):
                is_measured = kind == "link" or name in plant.signals
                if is_measured and name not in columns and name != "di":
                    noise = NOISE[name.rsplit("_", 1)[-1]] * rng.standard_normal(len(y))
                    columns[name] = y[:, k] + noise
            if kind == "link":
                places_m = rigid_markers_m(columns["angle_1_rad"][:, None])
                places_m += 1.5e-4 * rng.standard_normal(places_m.shape)
                columns |= marker_columns({f"m{i + 1:02d}": places_m[:, i] for i in range(16)})
            result.append(replace(trial, columns=columns))
    return tuple(result)


def _commanded(kind, payload_kg, number):
    time_s = STEP_S * np.arange(ROWS)
    wave = np.sin(2 * np.pi * np.maximum(time_s - REST * STEP_S, 0) / PERIOD_S)
    columns, more = {"time_s": time_s}, {}
    if kind == "link":
        columns["goal_1_rad"] = 0.5 * wave
        more = {"payload_kg": payload_kg, "pressure_pa": 41300.0, "amplitude_rad": 0.5,
                "base_offset_m": 0.06, "link_length_m": 0.95, "link_width_m": 0.15}  # fmt: skip
    elif kind == "pendulum":
        columns |= {"goal_1_rad": 0.8 * wave, "enabled_1": np.ones(ROWS)}
        columns["supply_1_v"] = np.full(ROWS, 7.5)
        more["conditions"] = {"mass_kg": 0.5 + payload_kg, "arm_length_m": 0.1, "duty_gain_1": 0.3}
    else:
        columns["command_1_v"] = 2.0 * wave
    common = {"dof": 1, "payload_kg": 0.0, "trial": number, "motion": "sinusoid", "source": "test",
              "period_s": PERIOD_S, "rest_samples": REST}  # fmt: skip
    return Trial(f"{kind}_{payload_kg:g}kg_{number}", TrialMeta(**common | more), columns)


# Changes of trials, and of the plant


def described(**changes):
    return lambda trials: [with_conditions(t, **changes) for t in trials]


def condition(**values):
    return lambda trials: [described(conditions=t.meta.conditions | values)([t])[0] for t in trials]


def columns(change):
    """Every trial with columns replaced by those that `change(trial)` returns."""
    return lambda trials: [with_columns(t, **change(t)) for t in trials]


def constant(prefix, value):
    return columns(
        lambda t: {n: np.full(len(t), value(c)) for n, c in t.columns.items()
                   if n.startswith(prefix)}
    )  # fmt: skip


def first_rows(count):
    def change(trials):
        short = [replace(t, columns={n: c[:count] for n, c in t.columns.items()}) for t in trials]
        return described(rest_samples=min(REST, count // 3))(short)

    return change


def step_of(step_s):
    return columns(lambda t: {"time_s": step_s * np.arange(len(t))})


def occluded(fraction, prefixes=("tip_", "m0", "m1")):
    def change(t):
        lost = np.random.default_rng(0).random(len(t)) < fraction
        return {
            n: np.where(lost, np.nan, c) for n, c in t.columns.items() if n.startswith(prefixes)
        }

    return columns(change)


def mixed(trials):
    """Trials of other length, step and motion together."""
    a, b, c, d = trials
    return [a, *first_rows(71)([b]), *described(motion="triangle")(step_of(0.011)([c])), d]


def renamed(old, new):
    return lambda trials: [
        replace(t, columns={new if n == old else n: c for n, c in t.columns.items()})
        for t in trials
    ]


def declaring(drop=(), **add):
    """Change of a plant whose file declares other signals."""

    def change(plant):
        signals = {n: s for n, s in plant.signals.items() if n not in drop}
        signals |= {name: SignalRole(*row) for name, row in add.items()}
        return replace(plant, signals=signals)

    return change


def at_bound(side):
    def change(plant):
        free = {n: q for n, q in plant.parameters.items() if q.role != "fixed"}
        return plant.with_values({n: getattr(q, side) for n, q in free.items()})

    return change


def same(anything):
    return anything


CASES = [
    ("link", "as made", same, same),
    ("link", "50 rows", first_rows(50), same),
    ("link", "markers mostly occluded", occluded(0.95, ("m0", "m1")), same),
    ("link", "no motion capture in one trial",
     lambda trials: [*occluded(1.0)(trials[:1]), *trials[1:]], same),
    ("link", "no current flows", constant("current_", lambda c: 0.0), same),
    ("link", "payload of 100 kg", described(payload_kg=100.0), same),
    ("link", "link of 1 mm", described(link_length_m=1e-3, link_width_m=1e-3), same),
    ("link", "angle far from its goal", constant("angle_", lambda c: 6.0), same),
    ("link", "all trials numbered alike", described(trial=1), same),
    ("link", "angle alone", same,
     declaring(goal_1_rad=("rad", "goal"), angle_1_rad=("rad", "measured"))),
    ("pendulum", "3 rows", first_rows(3), same),
    ("pendulum", "lengths, steps and motions differ", mixed, same),
    ("pendulum", "no rest rows", described(rest_samples=0), same),
    ("pendulum", "never enabled", constant("enabled_", lambda c: 0.0), same),
    ("pendulum", "condition that is not a number", condition(mass_kg=float("nan")), same),
    ("pendulum", "gain of a million", condition(duty_gain_1=1e6), same),
    ("pendulum", "clock of an epoch", columns(lambda t: {"time_s": t.time_s + 1.7e9}), same),
    ("pendulum", "current, but no angle", renamed("angle_1_rad", "current_1_a"),
     declaring(["angle_1_rad"], current_1_a=("A", "measured"))),
    ("pendulum", "nothing measured", same, declaring(["angle_1_rad"])),
    ("pendulum", "every parameter at its upper bound", same, at_bound("high")),
    ("guide", "nothing moves",
     columns(lambda t: {n: np.full(len(t), c[0]) for n, c in t.columns.items() if n != "time_s"}),
     same),
    ("guide", "period of zero", described(period_s=0.0), same),
    ("guide", "one trial", lambda trials: trials[:1], same),
    ("guide", "ten microseconds between rows", step_of(1e-5), same),
    ("guide", "command of a thousand volts", constant("command_", lambda c: 1e3), same),
]  # fmt: skip

CONSIDERED = {
    "link": ("coulomb_friction", "unmodelled_payload", "current_saturation"),
    "pendulum": ("coulomb_friction", "current_saturation"),
    "guide": ("coulomb_friction", "load_offset"),
}
FEW_STEPS = {
    fitted_floor: {"FLOOR_ROUNDS": 1},
    nuisance_fit: {"ROUNDS": 1},
    gauss_newton: {"NUISANCE_FIT_STEPS": 2, "FIT_STEPS": 2},
    effect_search: {"REFITTED": 1, "REFITTED_PAIRS": 1, "START_STEPS": 1, "FIT_STEPS": 1},
    far_strengths: {"LADDER_BOUND_FRACTIONS": (0.5,), "LADDER_REFINEMENTS": 1, "FIT_STEPS": 1},
    localisation: {"BOOTSTRAP_DRAWS": 20},
    noise_floor: {"FLOOR_ROUNDS": 1, "FIT_STEPS": 2},
    identification: {"DRAWS": 3, "STIFFNESS_SCAN": (1.0,)},
}


@pytest.fixture
def few_steps(monkeypatch):
    """Fits end after a few steps: the figures do not matter here."""
    fit = identification.fit_objective
    monkeypatch.setattr(
        identification, "fit_objective",
        lambda objective, start=None, **o: fit(objective, start, **o | {"evaluations": 2}),
    )  # fmt: skip
    for module, constants in FEW_STEPS.items():
        for name, value in constants.items():
            monkeypatch.setattr(module, name, value)


def check(capsys, argv, documents):
    """Run a command; it either ends with documents of finite numbers or with one sentence."""
    code = main([str(a) for a in argv])
    error = [row for row in capsys.readouterr().err.splitlines() if row.startswith("dropstitch: ")]
    assert code in (0, 1, 2)
    if code == 2:
        assert len(error) == 1 and re.fullmatch(r"dropstitch: .+; .+\.", error[0]), error
        return
    assert not error
    for path in documents:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"\b(NaN|Infinity)\b", text), path.name
        assert all(math.isfinite(v) for v in numbers(json.loads(text)))


def numbers(value):
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from numbers(part)
    elif isinstance(value, float):
        yield value


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    ("kind", "name", "change", "of_plant"), CASES, ids=[f"{c[0]}: {c[1]}" for c in CASES]
)
def test_an_admitted_trial_is_used_or_refused_in_one_sentence(
    kind, name, change, of_plant, few_steps, tmp_path, capsys
):
    trials, plant, out = tmp_path / "trials", of_plant(read_plant(PLANTS[kind])), tmp_path / "gap"
    for trial in change(list(made(kind))):
        write_trial(trial, trials)
    start, identified = tmp_path / "start.json", tmp_path / "plant.json"
    plant.write(start)
    check(capsys, ["evaluate", trials, "--plant", start], [])
    check(capsys, ["identify", trials, "--plant", start, "--out", identified], [identified])
    used = identified if identified.exists() and kind == "link" else start
    denied = [e for e in candidate_effects(plant) if e not in CONSIDERED[kind]]
    argv = ["gap", trials, "--plant", used, "--out", out]
    argv += [a for e in denied for a in ("--without", e)]
    check(capsys, argv, [out / "gap.json", out / "plant.json"])
