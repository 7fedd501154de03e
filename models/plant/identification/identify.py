"""Further starts of the drive's fit, whose cost has several local minima.

A servo may have options (`OPTIONS`), which a plant lacks until the data support them:

- A limit of the goal's acceleration. Above the motion's own acceleration it has no effect, so no
  step of a fit leads from "none" to a limit.
- Feed-forward of the rate with an integral of the position error, and a set-point weight of the
  velocity loop. If they were free in every fit, they would be confused with the loop's gains.

A servo that holds its goals and one that interpolates them are confused too, by the phase at which
the current is sampled. The servos of one robot usually do the same.

Identification of a plant: nuisance parameters, effects and marker calibration.

The trials to fit are those that `TrialSet.split` selects; all others are held out.

1. Scan the stiffness: compute the cost at some multiples of it. Then the fit starts near the right
   first mode and does not converge to a wrong cycle of the vibration.
2. Fit the link, driven by the measured angles, to end effector, Deformation Index and current.
   Without a servo loop, a wrong gain cannot hide a wrong stiffness.
3. Fit the drive and its friction: the twin, driven by the goals, to angle and current. The first
   round also tries options that a servo may have beside its cascade; if the goals of two joints
   differ in shape, it tries either for both (`models.plant.identification.identify`).
4. Repeat both on all trials, weighted by the errors of the first round. The first round uses only
   the trials with the fewest joints, which are fastest.

A plane that no trial moves takes the values of the other: the link's section is square and the
servos are of one type.

Gains that the servos had in the trials of an identification, from a log or robot.toml.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.bus.servo_settings import GAINS, ServoGains
from firmware_py.config import read_config
from firmware_py.errors import InputError
from firmware_py.log.recording import read_recording
from models.plant.components import DRIVES, LOADS
from models.plant.components.goal import NO_ACCELERATION_LIMIT
from models.plant.document import Evaluation, Provenance
from models.plant.effects import EFFECTS
from models.plant.identification.evaluation import evaluate_plant
from models.plant.identification.fit import Objective, Solution, fit_objective
from models.plant.parameter import Parameter
from models.plant.plant import ModelKind, Plant, scope_of
from models.plant.simulation.runner import Array
from models.trials.trial import Trial, TrialSet


@dataclass(frozen=True)
class DriveOption:
    """Option that a servo may or may not have."""

    # Value that means "none", by the start of a parameter's name
    none: dict[str, float]
    starts: tuple[tuple[float, ...], ...]  # Values from which fits start, one for each parameter


OPTIONS: Final = (
    DriveOption({"profile_acceleration_": NO_ACCELERATION_LIMIT}, ((30.0,), (10.0,))),
    DriveOption({"velocity_feedforward_": 0.0, "position_integral_": 0.0}, ((0.3, 2.0),)),
    DriveOption({"setpoint_weight_": 1.0}, ((0.8,),)),
)
"""Options of a servo with a cascade. At the study's 0.75 rad/s the limits delay a goal by 12 and
38 ms; the others are moderate settings [assumed]."""

OPTION_FALL: Final = 0.1
"""Smallest relative decrease of the drive's cost for which an option is accepted [assumed]."""

SHAPE: Final = ("goal_interpolation_{j}", "current_phase_{j}", "goal_delay_{j}_s")
"""Parameters of a goal's shape within the step."""

SHAPES_DIFFER: Final = 0.3
"""Difference between two joints' interpolation above which each is tried for both [assumed]."""


def starts_with_option(plant: Plant) -> list[Plant]:
    """Plants with one more option, its parameters free, for each that the plant does not have."""
    result = []
    for option in OPTIONS:
        own = [(n, q) for n, q in plant.parameters.items() if n.startswith(tuple(option.none))]
        known = any(
            q.role != "fixed" or q.value != none
            for begin, none in option.none.items() for n, q in own if n.startswith(begin)
        )  # fmt: skip
        if known or not own:
            continue
        for values in option.starts:
            start = dict(zip(option.none, values, strict=True))
            result.append(_with_parameters(plant, [
                msgspec.structs.replace(
                    q, value=value, role="nuisance", prior_deviation=q.prior_deviation or value
                )
                for begin, value in start.items() for n, q in own if n.startswith(begin)
            ]))  # fmt: skip
    return result


def with_options_of(plant: Plant, other: Plant) -> Plant:
    """Plant with the options of another one; their fitted values are the priors."""
    begins = tuple(begin for option in OPTIONS for begin in option.none)
    return _with_parameters(plant, (q for n, q in other.parameters.items() if n.startswith(begins)))


def starts_with_alike_servos(plant: Plant) -> list[Plant]:
    """Plants in which both joints' goals have one joint's shape; none if the shapes are alike."""
    interpolation = [plant.parameters.get(SHAPE[0].format(j=j)) for j in (1, 2)]
    values = [q.value for q in interpolation if q is not None and q.role != "fixed"]
    if len(values) < 2 or abs(values[0] - values[1]) <= SHAPES_DIFFER:
        return []
    return [
        plant.with_values(
            {q.format(j=b): plant.parameters[q.format(j=a)].value for q in SHAPE}
        )
        for a, b in ((1, 2), (2, 1))
    ]  # fmt: skip


def _with_parameters(plant: Plant, parameters: Iterable[Parameter]) -> Plant:
    return replace(plant, parameters={**plant.parameters, **{q.name: q for q in parameters}})


STIFFNESS_SCAN: Final = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on the initial stiffness in the scan."""

DRIVEN_SUBSTEP_S: Final = 2.2e-3
"""Longest internal step of the driven link, an eighth of a period, as it has no dry friction."""

DRAWS: Final = 32
"""Number of starts drawn for the fit of a rigid load."""

FITTED_STARTS: Final = 2
"""Number of the best starts to fit from, in addition to the plant itself."""

LINK_SIGNALS: Final = ("tip", "di", "current")
DRIVE_SIGNALS: Final = ("angle", "position", "current")
ALL_SIGNALS: Final = ("",)

Report = Callable[[str], None]


@dataclass(frozen=True)
class Identification:
    """Result of an identification.

    Attributes
    ----------
    plant : Plant
        Identified plant, with provenance.
    fitted : tuple of Parameter
        Fitted parameters with standard errors.
    held_out : Evaluation
        Errors on the held-out trials, or on the fitted ones if none are held out.
    """

    plant: Plant
    fitted: tuple[Parameter, ...]
    held_out: Evaluation


def identify(plant: Plant, trials: TrialSet, report: Report = lambda text: None) -> Identification:
    """Fit a plant to trials.

    Parameters
    ----------
    plant : Plant
        Start of the fit; its values and bounds are the priors.
    trials : TrialSet
        Trials of one joint, two joints or both.
    report : callable
        Called with one phrase of progress after each run of all trials.

    Raises
    ------
    InputError
        If there are no trials, or one has more joints than the plant or lacks one of its inputs.
    """
    if not len(trials):
        raise InputError("trials", "are none", "give at least one")
    fit, held_out = trials.split()
    planes = max(t.meta.dof for t in fit)
    if planes > LOADS[plant.load].max_dof:
        raise InputError(
            f"plant {plant.name!r}",
            f"has one joint, a trial has {planes}",
            "use a plant of the link",
        )
    link, drive = free_parameters(plant, planes)
    first = [t for t in fit if t.meta.dof == min(t.meta.dof for t in fit)]
    if plant.load == "link":
        found = _scan_stiffness(plant, first, report)
        found, rms = _fit_link_and_drive(found, plant, first, None, report)
        found = _with_second_plane(found, first)
        prior = with_options_of(plant, found)
        found, rms = _fit_link_and_drive(found, prior, fit.trials, rms, report)
    else:
        every = tuple(dict.fromkeys((*link, *drive)))  # friction is in both
        solution = _best_of_several(
            Objective(plant, "twin", fit.trials, every, ALL_SIGNALS), report
        )
        found, rms = solution.plant, solution.rms
    found = _with_second_plane(found, fit.trials)
    errors = evaluate_plant(found, held_out if len(held_out) else fit)
    link, drive = free_parameters(found, planes)
    fitted = tuple(dict.fromkeys((*link, *drive)))
    provenance = Provenance(
        parent_sha256=plant.sha256(),
        data_sha256=trials.sha256(),
        fitted_trials=plant.provenance.fitted_with(fit),
        held_out_trials=tuple(t.name for t in held_out),
        fitted_parameters=fitted,
        residual_rms=rms,
        held_out=errors,
    )
    found = replace(found, name=f"{_base_name(plant.name)}, identified", provenance=provenance)
    return Identification(found, tuple(found.parameters[n] for n in fitted), errors)


def _best_of_several(objective: Objective, report: Report) -> Solution:
    """Best of the fits from the plant itself and from draws of the prior.

    A sticking joint makes the cost discontinuous: its rest position jumps as a parameter changes.
    """
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((DRAWS, len(objective.free)))
    drawn = objective.start + objective.prior_deviation * normal
    starts = [objective.start, *np.clip(drawn, objective.low, objective.high)]
    costs = np.array([float(r @ r) for r in (objective(start)[0] for start in starts)])
    report(f"{DRAWS} starts drawn")
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf))[:FITTED_STARTS]
    fits = [
        fit_objective(
            objective, starts[k], evaluations=60, tolerance=1e-5,
            report=lambda cost: report(f"cost {cost:.4g}"),
        )
        for k in dict.fromkeys((0, *order))
    ]  # fmt: skip
    return min(fits, key=lambda s: s.cost)


def _fit_link_and_drive(
    plant: Plant, prior: Plant, trials: Sequence[Trial], rms: dict[str, float] | None,
    report: Report,
) -> tuple[Plant, dict[str, float]]:  # fmt: skip
    """Fit the link, then the drive; the residuals of an earlier round are the weights."""
    planes = max(t.meta.dof for t in trials)
    link, drive = free_parameters(plant, planes)
    angles = {n: v for n, v in (rms or {}).items() if n.startswith("angle_")}
    first = _fit_stage(plant, prior, "driven", trials, link, LINK_SIGNALS, rms, report)
    extremes = _payload_extremes(trials)
    second = _fit_stage(first.plant, prior, "twin", extremes, drive, DRIVE_SIGNALS, angles, report)
    while rms is None:
        optional = [
            _fit_stage(
                start, with_options_of(prior, start), "twin", extremes,
                free_parameters(start, planes)[1], DRIVE_SIGNALS, angles, report,
            )
            for start in starts_with_option(second.plant)
        ]  # fmt: skip
        best = min(optional, key=lambda s: s.cost, default=second)
        if best.cost > (1 - OPTION_FALL) * second.cost:
            break
        second = best
    drive = free_parameters(second.plant, planes)[1]
    if planes == 2:
        alike = [
            _fit_stage(start, prior, "twin", extremes, drive, DRIVE_SIGNALS, angles, report)
            for start in starts_with_alike_servos(second.plant)
        ]
        second = min([second, *alike], key=lambda s: s.cost)
    angles = {n: v for n, v in second.rms.items() if n.startswith("angle_")}
    return second.plant, angles | first.rms


def _payload_extremes(trials: Sequence[Trial]) -> list[Trial]:
    """Smallest, middle and largest payload of each number of joints: enough for the drive."""
    chosen: list[Trial] = []
    for dof in sorted({t.meta.dof for t in trials}):
        own = sorted((t for t in trials if t.meta.dof == dof), key=lambda t: t.meta.payload_kg)
        chosen += [own[k] for k in sorted({0, len(own) // 2, len(own) - 1})]
    return chosen


def _base_name(name: str) -> str:
    return name.removesuffix(", identified").removesuffix(", nominal")


def free_parameters(plant: Plant, planes: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters to fit in the link's stage and in the drive's; friction is in both."""
    scope = scope_of(plant.drive, plant.load, planes)

    def wanted(part: Any) -> list[str]:
        declared = [q.name for q in part.parameters(scope)]
        return [name for name in declared if plant.parameters[name].role != "fixed"]

    load, drive = wanted(LOADS[plant.load]()), wanted(DRIVES[plant.drive]())
    for name in plant.effects:
        rows = wanted(EFFECTS[name]())
        if EFFECTS[name].port != "command":
            load += rows
        if EFFECTS[name].port in ("command", "servo_torque"):
            drive += rows
    in_the_current_too = ("rotor_inertia_", "torque_constant_")
    load += [name for name in drive if name.startswith(in_the_current_too)]
    return tuple(load), tuple(drive)


def _scan_stiffness(plant: Plant, trials: Sequence[Trial], report: Report) -> Plant:
    """Plant with all stiffness multiplied by the best factor of `STIFFNESS_SCAN`."""
    link, _ = free_parameters(plant, max(t.meta.dof for t in trials))
    stiffness = [n for n in link if "_stiffness_" in n and n.endswith("_nm_rad")]
    objective = Objective(
        plant, "driven", trials, stiffness, LINK_SIGNALS, max_substep_s=DRIVEN_SUBSTEP_S
    )

    def scaled(factor: float) -> Array:
        return np.clip(factor * objective.start, objective.low, objective.high)

    costs: dict[float, float] = {}
    for factor in STIFFNESS_SCAN:
        residual = objective(scaled(factor))[0]
        cost = float(residual @ residual)
        costs[factor] = cost if np.isfinite(cost) else np.inf
        report(f"stiffness x {factor:g}")
    best = min(costs, key=lambda factor: costs[factor])
    return plant.with_values(dict(zip(stiffness, scaled(best), strict=True)))


def _fit_stage(
    plant: Plant,
    prior: Plant,
    kind: ModelKind,
    trials: Sequence[Trial],
    free: Sequence[str],
    signals: Sequence[str],
    scale: dict[str, float] | None,
    report: Report,
) -> Solution:
    """Fit the free parameters of one model to the chosen signals."""
    substep_s = DRIVEN_SUBSTEP_S if kind == "driven" else None
    what = f"{'link' if kind == 'driven' else 'drive'}, {len(trials)} trials"
    return fit_objective(
        Objective(plant, kind, trials, free, signals, scale, substep_s, prior),
        evaluations=25, tolerance=1e-3,
        report=lambda cost: report(f"{what}: cost {cost:.4g}"),
    )  # fmt: skip


def _with_second_plane(plant: Plant, trials: Sequence[Trial]) -> Plant:
    """Plant with the first plane's values in the second (except prebend), if no trial moves it."""
    if LOADS[plant.load].max_dof == 1 or any(t.meta.dof == 2 for t in trials):
        return plant
    parameters = dict(plant.parameters)
    for name, q in plant.parameters.items():
        other = parameters.get(name.replace("_1", "_2", 1))
        if "_1" in name and other and other.role != "fixed" and "prebend" not in name:
            parameters[other.name] = msgspec.structs.replace(
                other, value=min(max(q.value, other.low), other.high), error=None
            )
    return replace(plant, parameters=parameters)


_LOG_SUFFIX: Final = ".mcap"


def read_servo_gains(path: Path) -> tuple[ServoGains, ...]:
    """Read the gains of each servo, in joint order.

    `path` is robot.toml or a log of `dropstitch run`, which records the gains read from the servos.
    """
    if path.suffix == _LOG_SUFFIX:
        gains = _found(path)
    else:
        gains = tuple(servo.gains or ServoGains() for servo in read_config(path).servos)
    if not gains or not all(one.registers() for one in gains):
        raise InputError(
            path, "does not give the gains of every servo",
            "name a log of this release, or add gains to each [[servos]]",
        )  # fmt: skip
    return gains


def _found(path: Path) -> tuple[ServoGains, ...]:
    text = read_recording(path).metadata.get("servo_settings", "[]")
    try:
        servos = msgspec.json.decode(text, type=list[dict[str, int]])
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"holds damaged settings ({error})", "name another log") from None
    return tuple(
        ServoGains(**{name: found.get(register.value) for name, register in GAINS.items()})
        for found in servos
    )
