"""Changes of a trial set that the contract of trials admits (docs/trials.md)."""

from dataclasses import replace

import msgspec
import numpy as np

from models.trials.trial import SignalRole
from tests.models.robustness.short_trials import short_trials


def _meta(trials, **changes):
    return [replace(t, meta=msgspec.structs.replace(t.meta, **changes)) for t in trials]


def _columns(trials, change):
    """Every trial with columns replaced by those that `change(trial)` returns."""
    return [replace(t, columns=t.columns | change(t)) for t in trials]


def _first_rows(trials, rows):
    short = [replace(t, columns={n: c[:rows] for n, c in t.columns.items()}) for t in trials]
    return [m for t in short for m in _meta([t], rest_samples=min(t.meta.rest_samples, rows // 3))]


def _only(name, value):
    def change(t):
        return {n: np.full(len(t), value(c)) for n, c in t.columns.items() if n.startswith(name)}

    return lambda trials: _columns(trials, change)


def _standing(trials):
    """Nothing moves, and nothing is noisy."""

    def change(t):
        return {n: np.full(len(t), c[0]) for n, c in t.columns.items() if n != "time_s"}

    return _columns(trials, change)


def _without(trials, prefixes, fraction=1.0):
    rng = np.random.default_rng(0)

    def change(t):
        lost = rng.random(len(t)) < fraction
        return {
            n: np.where(lost, np.nan, c) for n, c in t.columns.items() if n.startswith(prefixes)
        }

    return _columns(trials, change)


def _other_step(trials, step_s):
    return _columns(trials, lambda t: {"time_s": step_s * np.arange(len(t))})


def _mixed(trials):
    """Trials of other length, step and motion together."""
    a, b, c, d = trials
    b = _first_rows([b], 71)[0]
    c = _meta(_other_step([c], 0.011), motion="triangle")[0]
    d = _meta([d], amplitude_rad=0.3, period_s=2.0)[0] if d.meta.amplitude_rad else d
    return [a, b, c, d]


def _condition(**values):
    return lambda trials: [_meta([t], conditions=t.meta.conditions | values)[0] for t in trials]


_MEASURED = ("angle_1_rad", "position_1_m")

COMMON = {
    "as made": lambda trials: trials,
    "one trial": lambda trials: trials[:1],
    "one payload": lambda trials: trials[:2],
    "one repetition": lambda trials: trials[::2],
    "all trials numbered alike": lambda trials: _meta(trials, trial=1),
    "50 rows": lambda trials: _first_rows(trials, 50),
    "9 rows": lambda trials: _first_rows(trials, 9),
    "3 rows": lambda trials: _first_rows(trials, 3),
    "no rest rows": lambda trials: _meta(trials, rest_samples=0),
    "rest rows only": lambda trials: _meta(trials, rest_samples=len(trials[0]) - 1),
    "nothing moves": _standing,
    "period of zero": lambda trials: _meta(trials, period_s=0.0),
    "period of hours": lambda trials: _meta(trials, period_s=1e4),
    "lengths, steps and motions differ": _mixed,
    "half a second between rows": lambda trials: _other_step(trials, 0.5),
    "ten microseconds between rows": lambda trials: _other_step(trials, 1e-5),
    "clock of an epoch": lambda trials: _columns(trials, lambda t: {"time_s": t.time_s + 1.7e9}),
}
LINK = {
    "constant angle": _only("angle_", np.mean),
    "constant current": _only("current_", np.mean),
    "no current flows": _only("current_", lambda c: 0.0),
    "constant goal": _only("goal_", lambda c: c[0]),
    "constant tip": _only("tip_", np.mean),
    "constant markers": _only("m", np.mean),
    "no motion capture": lambda trials: _without(trials, ("tip_", "m0", "m1")),
    "no motion capture in one trial": lambda trials: [
        *_without(trials[:1], ("tip_", "m0", "m1")), *trials[1:]],
    "markers mostly occluded": lambda trials: _without(trials, ("m0", "m1"), 0.95),
    "one marker never seen": lambda trials: _without(trials, ("m07",)),
    "markers seen once": lambda trials: _columns(
        trials, lambda t: {n: np.where(np.arange(len(t)) == 2, c, np.nan)
                           for n, c in t.columns.items() if n.startswith(("m0", "m1"))}),
    "payload of 100 kg": lambda trials: _meta(trials, payload_kg=100.0),
    "link of 100 m": lambda trials: _meta(trials, link_length_m=100.0),
    "link of 1 mm": lambda trials: _meta(trials, link_length_m=1e-3, link_width_m=1e-3),
    "no amplitude": lambda trials: _meta(trials, amplitude_rad=0.0),
    "no pressure": lambda trials: _meta(trials, pressure_pa=0.0),
    "base 10 m above the joint": lambda trials: _meta(trials, base_offset_m=10.0),
    "further column": lambda trials: _columns(
        trials, lambda t: {"temperature_1_degc": np.full(len(t), np.nan)}),
    "markers at the limit": _only("m1", lambda c: 100.0),
    "current at the limit": _only("current_", lambda c: 100.0),
    "angle far from its goal": _only("angle_", lambda c: 6.0),
    "one and two joints": lambda trials: [
        *trials, *short_trials("link", payloads=(1.0,), repeats=1, dof=2)],
}  # fmt: skip
OTHERS = {
    "constant measurement": lambda trials: _columns(
        trials, lambda t: {n: np.full(len(t), 0.1) for n in _MEASURED if n in t.columns}),
    "no supply": _only("supply_", lambda c: 0.0),
    "never enabled": _only("enabled_", lambda c: 0.0),
    "constant goal": _only("goal_", lambda c: 0.3),
    "no command": _only("command_", lambda c: 0.0),
    "command of a thousand volts": _only("command_", lambda c: 1e3),
    "no mass": _condition(mass_kg=0.0),
    "gain of a million": _condition(duty_gain_1=1e6),
    "condition that is not a number": _condition(mass_kg=float("nan")),
    "condition that no parameter has": _condition(colour=3.0),
}  # fmt: skip
CASES = [("link", name, change) for name, change in (COMMON | LINK).items()]
CASES += [
    (kind, name, change)
    for kind in ("pendulum", "guide")
    for name, change in (COMMON | OTHERS).items()
]


def _signals(drop=(), **add):
    def change(plant):
        kept = {n: s for n, s in plant.signals.items() if n not in drop}
        return replace(plant, signals=kept | {n: SignalRole(*s) for n, s in add.items()})

    return change


def _link_with(*measured):
    """A link whose file declares its signals."""
    units = {"rad": "rad", "a": "A", "m": "m"}
    rows = {name: (units[name.rsplit("_", 1)[-1]], "measured") for name in measured}
    return _signals(goal_1_rad=("rad", "goal"), **rows)


def _renamed(old, new):
    return lambda trials: [
        replace(t, columns={new if n == old else n: c for n, c in t.columns.items()})
        for t in trials
    ]


def _same(trials):
    return trials


PLANT_CASES = [
    ("pendulum", "current, but no angle", _renamed("angle_1_rad", "current_1_a"),
     _signals(["angle_1_rad"], current_1_a=("A", "measured"))),
    ("pendulum", "nothing measured", _same, _signals(["angle_1_rad"])),
    ("pendulum", "something else measured", _renamed("angle_1_rad", "temperature_1_degc"),
     _signals(["angle_1_rad"], temperature_1_degc=("degC", "measured"))),
    ("pendulum", "supply not declared", _same, _signals(["supply_1_v"])),
    ("pendulum", "goal not declared", _same, _signals(["goal_1_rad"])),
    ("guide", "nothing measured", _same, _signals(["position_1_m"])),
    ("link", "angle alone", _same, _link_with("angle_1_rad")),
    ("link", "current alone", _same, _link_with("current_1_a")),
    ("link", "tip alone", _same, _link_with("tip_x_m", "tip_y_m", "tip_z_m")),
    ("link", "one coordinate of the tip", _same, _link_with("angle_1_rad", "tip_x_m")),
    ("link", "no dimensions", lambda trials: _meta(
        trials, pressure_pa=0.0, amplitude_rad=0.0, base_offset_m=0.0, link_length_m=0.0,
        link_width_m=0.0), _link_with("angle_1_rad", "current_1_a")),
    ("link", "gains at their bounds", _same, lambda plant: plant.with_values(
        {n: q.high if "gain" in n else q.low for n, q in plant.parameters.items()
         if "_gain_" in n or "integral_time" in n or "rotor_inertia" in n})),
    ("link", "no damping and no stiffness", _same, lambda plant: plant.with_values(
        {n: q.low for n, q in plant.parameters.items() if "stiffness" in n or "damping" in n})),
    ("pendulum", "every parameter at its upper bound", _same, lambda plant: plant.with_values(
        {n: q.high for n, q in plant.parameters.items() if q.role != "fixed"})),
    ("pendulum", "every parameter at its lower bound", _same, lambda plant: plant.with_values(
        {n: q.low for n, q in plant.parameters.items() if q.role != "fixed"})),
]  # fmt: skip
"""Plants that declare other signals, or start from extreme values."""
