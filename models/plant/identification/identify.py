"""Identification of a plant of the link, or of another load, from trials.

`TrialSet.split` selects the trials to fit; all others are held out. The plant of a link:

1. Scan the stiffness: compute the cost at some multiples of it. Then the fit starts near the right
   first mode and does not converge to a wrong cycle of the vibration.
2. Fit the link, driven by the measured angles, to end effector, Deformation Index and current.
   Without a servo loop, a wrong gain cannot hide a wrong stiffness.
3. Fit the drive and its friction: the twin, driven by the goals, to angle and current. Then try the
   options that a servo may have beside its cascade.
4. Repeat 2 and 3 on all trials, weighted by the residuals of the first round. The first round uses
   only the trials with the fewest joints, which are fastest.

Any other load is fitted at once, from several starts. A plane that no trial moves takes the values
of the other: the link's section is square and the servos are of one type.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import msgspec
import numpy as np

from firmware_py.errors import InputError
from models.plant.components import DRIVES, LOADS
from models.plant.components.goal import NO_ACCELERATION_LIMIT
from models.plant.document import Evaluation, Provenance
from models.plant.effects import EFFECTS
from models.plant.identification.evaluation import evaluate_plant
from models.plant.identification.fit import Objective, Solution, fit_objective
from models.plant.parameter import Parameter
from models.plant.plant import Plant, scope_of
from models.plant.simulation.runner import Array
from models.trials.trial import Trial, TrialSet

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


def identify(
    plant: Plant, trials: Iterable[Trial], report: Report = lambda text: None
) -> Identification:
    """Fit a plant to trials.

    Parameters
    ----------
    plant : Plant
        Start of the fit; its values and bounds are the priors.
    trials : TrialSet or iterable of Trial
        Trials of one joint, two joints or both.
    report : callable
        Called with one phrase of progress after each run of all trials.

    Returns
    -------
    Identification
        Plant with provenance, fitted parameters, and errors on the held-out trials.

    Raises
    ------
    InputError
        If there are no trials, or one has more joints than the plant or lacks one of its inputs.
    """
    trials = TrialSet(tuple(trials))
    if not len(trials):
        raise InputError("trials", "are none", "give at least one")
    fit, held_out = trials.split()
    planes = _planes(fit)
    if planes > LOADS[plant.load].max_dof:
        raise InputError(
            f"plant {plant.name!r}",
            f"has one joint, a trial has {planes}",
            "use a plant of the link",
        )
    solve = _fit_link_plant if plant.load == "link" else _fit_from_several_starts
    solution = solve(plant, fit, report)
    result = _with_second_plane(solution.plant, fit)
    fitted = tuple(dict.fromkeys(n for part in free_parameters(result, planes) for n in part))
    errors = evaluate_plant(result, held_out if len(held_out) else fit)
    provenance = Provenance(
        parent_sha256=plant.sha256(),
        data_sha256=trials.sha256(),
        fitted_trials=plant.provenance.fitted_with(fit),
        held_out_trials=tuple(t.name for t in held_out),
        fitted_parameters=fitted,
        residual_rms=solution.rms,
        held_out=errors,
    )
    name = plant.name.removesuffix(", identified").removesuffix(", nominal")
    result = replace(result, name=f"{name}, identified", provenance=provenance)
    return Identification(result, tuple(result.parameters[n] for n in fitted), errors)


def free_parameters(plant: Plant, planes: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters to fit with the link and with the drive; friction is in both."""
    scope = scope_of(plant.drive, plant.load, planes)

    def free(part: Any) -> list[str]:
        declared = [q.name for q in part.parameters(scope)]
        return [name for name in declared if plant.parameters[name].role != "fixed"]

    load, drive = free(LOADS[plant.load]()), free(DRIVES[plant.drive]())
    for name in plant.effects:
        port, own = EFFECTS[name].port, free(EFFECTS[name]())
        if port != "command":
            load += own
        if port in ("command", "servo_torque"):
            drive += own
    load += [n for n in drive if n.startswith(("rotor_inertia_", "torque_constant_"))]  # in current
    return tuple(load), tuple(drive)


def _planes(trials: Iterable[Trial]) -> int:
    return max(t.meta.dof for t in trials)


# Loads other than the link

DRAWS: Final = 32
"""Number of starts drawn for the fit of a rigid load."""

FITTED_STARTS: Final = 2
"""Number of the best starts to fit from, in addition to the plant itself."""


def _fit_from_several_starts(plant: Plant, trials: Sequence[Trial], report: Report) -> Solution:
    """Best of the fits from the plant itself and from draws of the prior.

    A sticking joint makes the cost discontinuous: its rest position jumps as a parameter changes.
    """
    free = dict.fromkeys(n for part in free_parameters(plant, _planes(trials)) for n in part)
    objective = Objective(plant, "twin", trials, tuple(free), ALL_SIGNALS)
    normal = np.random.default_rng(0).standard_normal((DRAWS, len(objective.free)))
    drawn = objective.start + objective.prior_deviation * normal
    starts = [objective.start, *np.clip(drawn, objective.low, objective.high)]
    order = np.argsort([_cost(objective, start) for start in starts])[:FITTED_STARTS]
    report(f"{DRAWS} starts drawn")
    fits = [
        fit_objective(
            objective, starts[k], evaluations=60, tolerance=1e-5,
            report=lambda cost: report(f"cost {cost:.4g}"),
        )
        for k in dict.fromkeys((0, *order))
    ]  # fmt: skip
    return min(fits, key=lambda s: s.cost)


def _cost(objective: Objective, values: Array) -> float:
    residual = objective(values)[0]
    cost = float(residual @ residual)
    return cost if np.isfinite(cost) else np.inf


# The link and its drive

STIFFNESS_SCAN: Final = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on the initial stiffness in the scan."""

OPTION_FALL: Final = 0.1
"""Smallest relative decrease of the drive's cost for which an option is accepted [assumed]."""


def _fit_link_plant(plant: Plant, trials: Sequence[Trial], report: Report) -> Solution:
    """Fit link and drive in two rounds, see the module's docstring."""
    fewest = min(t.meta.dof for t in trials)
    first = [t for t in trials if t.meta.dof == fewest]
    link = _fit_link(_scan_stiffness(plant, first, report), plant, first, {}, report)
    drive = _fit_drive(link.plant, plant, first, {}, report)
    drive = _with_servo_options(drive, plant, first, report)
    drive = _with_alike_servos(drive, plant, first, {}, report)
    rms = _angles(drive.rms) | link.rms

    start = _with_second_plane(drive.plant, first)
    prior = with_options_of(plant, start)
    link = _fit_link(start, prior, trials, rms, report)
    drive = _fit_drive(link.plant, prior, trials, rms, report)
    drive = _with_alike_servos(drive, prior, trials, rms, report)
    return replace(drive, rms=_angles(drive.rms) | link.rms)


def _scan_stiffness(plant: Plant, trials: Sequence[Trial], report: Report) -> Plant:
    """Plant with all stiffness multiplied by the best factor of `STIFFNESS_SCAN`."""
    link, _ = free_parameters(plant, _planes(trials))
    stiffness = [n for n in link if "_stiffness_" in n and n.endswith("_nm_rad")]
    objective = Objective(plant, "driven", trials, stiffness, LINK_SIGNALS)
    costs: list[tuple[float, Array]] = []
    for factor in STIFFNESS_SCAN:
        values = np.clip(factor * objective.start, objective.low, objective.high)
        costs.append((_cost(objective, values), values))
        report(f"stiffness x {factor:g}")
    _, best = min(costs, key=lambda row: row[0])
    return plant.with_values(dict(zip(stiffness, best, strict=True)))


def _fit_link(
    start: Plant, prior: Plant, trials: Sequence[Trial], rms: Mapping[str, float], report: Report
) -> Solution:
    """Fit the link's parameters while the measured angles drive it."""
    free, _ = free_parameters(start, _planes(trials))
    return fit_objective(
        Objective(start, "driven", trials, free, LINK_SIGNALS, rms, prior),
        evaluations=25, tolerance=1e-3,
        report=lambda cost: report(f"link, {len(trials)} trials: cost {cost:.4g}"),
    )  # fmt: skip


def _fit_drive(
    start: Plant, prior: Plant, trials: Sequence[Trial], rms: Mapping[str, float], report: Report
) -> Solution:
    """Fit the drive's parameters while the goals drive the twin.

    The smallest, middle and largest payload of each number of joints are enough.
    """
    chosen: list[Trial] = []
    for dof in sorted({t.meta.dof for t in trials}):
        same = sorted((t for t in trials if t.meta.dof == dof), key=lambda t: t.meta.payload_kg)
        chosen += [same[k] for k in sorted({0, len(same) // 2, len(same) - 1})]
    _, free = free_parameters(start, _planes(trials))
    return fit_objective(
        Objective(start, "twin", chosen, free, DRIVE_SIGNALS, _angles(rms), prior),
        evaluations=25, tolerance=1e-3,
        report=lambda cost: report(f"drive, {len(chosen)} trials: cost {cost:.4g}"),
    )  # fmt: skip


def _angles(rms: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in rms.items() if name.startswith("angle_")}


def _with_servo_options(
    drive: Solution, prior: Plant, trials: Sequence[Trial], report: Report
) -> Solution:
    """Fit of the drive with each option that lowers its cost enough, the best one first."""
    while True:
        fits = [
            _fit_drive(start, with_options_of(prior, start), trials, {}, report)
            for start in starts_with_option(drive.plant)
        ]
        best = min(fits, key=lambda s: s.cost, default=drive)
        if best.cost >= (1 - OPTION_FALL) * drive.cost:
            return drive
        drive = best


def _with_alike_servos(
    drive: Solution, prior: Plant, trials: Sequence[Trial], rms: Mapping[str, float], report: Report
) -> Solution:
    """Best of the fit and of those in which both servos shape their goals alike."""
    if _planes(trials) < 2:
        return drive
    starts = starts_with_alike_servos(drive.plant)
    fits = [_fit_drive(start, prior, trials, rms, report) for start in starts]
    return min([drive, *fits], key=lambda s: s.cost)


def _with_second_plane(plant: Plant, trials: Sequence[Trial]) -> Plant:
    """Plant with the first plane's values in the second (except prebend), if no trial moves it."""
    if LOADS[plant.load].max_dof == 1 or _planes(trials) == 2:
        return plant
    second = []
    for name, q in plant.parameters.items():
        other = plant.parameters.get(name.replace("_1", "_2", 1))
        if "_1" in name and other and other.role != "fixed" and "prebend" not in name:
            value = min(max(q.value, other.low), other.high)
            second.append(msgspec.structs.replace(other, value=value, error=None))
    return _with_parameters(plant, second)


# Further starts of the drive's fit, whose cost has several local minima

ABSENT: Final = {
    "profile_acceleration_": NO_ACCELERATION_LIMIT,
    "velocity_feedforward_": 0.0,
    "position_integral_": 0.0,
    "setpoint_weight_": 1.0,
}
"""Value of a servo option that means "none", by the start of the parameter's name."""

OPTION_STARTS: Final[tuple[dict[str, float], ...]] = (
    {"profile_acceleration_": 30.0},
    {"profile_acceleration_": 10.0},
    {"velocity_feedforward_": 0.3, "position_integral_": 2.0},
    {"setpoint_weight_": 0.8},
)
"""Options from which a fit starts. No step of a fit leads from no limit of the goal's acceleration
to a limit, because one above the motion's own acceleration has no effect: at the study's 0.75 rad/s
these two delay a goal by 12 and 38 ms. The others are moderate settings [assumed]; if they were
free in every fit, they would be confused with the loop's gains."""

SHAPE: Final = ("goal_interpolation_{j}", "current_phase_{j}", "goal_delay_{j}_s")
"""Parameters of a goal's shape within the step."""

SHAPES_DIFFER: Final = 0.3
"""Difference between two joints' interpolation above which each is tried for both [assumed]."""


def starts_with_option(plant: Plant) -> list[Plant]:
    """Plants with one more option, its parameters free, for each that the plant does not have."""
    result = []
    for start in OPTION_STARTS:
        own = [(p, q) for n, q in plant.parameters.items() for p in start if n.startswith(p)]
        if own and all(q.role == "fixed" and q.value == ABSENT[p] for p, q in own):
            result.append(_with_parameters(plant, [
                msgspec.structs.replace(
                    q, value=start[p], role="nuisance",
                    prior_deviation=q.prior_deviation or start[p],
                )
                for p, q in own
            ]))  # fmt: skip
    return result


def with_options_of(plant: Plant, other: Plant) -> Plant:
    """Plant with the options of another one; their fitted values are the priors."""
    options = [q for n, q in other.parameters.items() if n.startswith(tuple(ABSENT))]
    return _with_parameters(plant, options)


def starts_with_alike_servos(plant: Plant) -> list[Plant]:
    """Plants in which both joints' goals have one joint's shape; none if the shapes are alike.

    A servo that holds its goals and one that interpolates them are confused, by the phase at which
    the current is sampled. The servos of one robot usually do the same.
    """
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
