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
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from firmware_py.bus.servo_models import ServoGains
from firmware_py.core.errors import InputError
from models.plant.components import LOADS
from models.plant.components.cascade import NO_ACCELERATION_LIMIT
from models.plant.document import Evaluation, Provenance
from models.plant.identification.doubts import doubts, refuse_other_links, torque_constant_doubts
from models.plant.identification.evaluation import evaluate_plant, over_payloads, plot_fit
from models.plant.identification.fit import (
    LINK_SIGNALS,
    Objective,
    Solution,
    fit_objective,
    free_parameters,
)
from models.plant.identification.noise_floor import with_noise_floor
from models.plant.identification.trial_spectra import check_duration
from models.plant.parameter import Parameter, bound_reached, is_weakly_determined
from models.plant.plant import Plant
from models.plant.simulation.runner import Array
from models.trials.checks.trials import judge_not_fitted, judge_pressures, refuse_unusable
from models.trials.trial import Trial, TrialSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Report = Callable[[str], None]


@dataclass(frozen=True, repr=False)
class Identification:
    """Result of `identify`.

    Attributes
    ----------
    plant : Plant
        Identified plant, with provenance and, where the trials repeat a motion, its noise floor.
    fitted : tuple of Parameter
        Fitted parameters with standard errors.
    held_out : Evaluation
        Errors on the held-out trials, or on the fitted ones if none are held out.
    trials : TrialSet
        All trials, fitted and held out.

    Examples
    --------
    >>> from models.plant.plant import read_plant
    >>> plant = read_plant("docs/notebooks/bundle_1dof/plant.json")
    >>> mass = plant.parameters["link_mass_kg"]
    >>> result = Identification(plant, (mass,), plant.provenance.held_out)
    >>> print(result.summary().splitlines()[1])
    link_mass_kg                          0.8225        0.11  kg
    """

    plant: Plant
    fitted: tuple[Parameter, ...]
    held_out: Evaluation
    trials: TrialSet = field(default_factory=TrialSet)

    def __repr__(self) -> str:
        return (
            f"<Identification of {self.plant.name!r}: {len(self.fitted)} parameters fitted; "
            f"{repr(self.held_out)[1:-1]}>"
        )

    def _repr_html_(self) -> str:
        from models.shared.notebook import html_table

        rows = [
            (q.name, f"{q.value:.4g}", f"{q.error or 0:.2g}", q.unit, _mark(q)) for q in self.fitted
        ]
        head = ("parameter", "value", "standard error", "unit", "")
        return html_table(repr(self)[1:-1], head, rows)

    def warnings(self) -> list[str]:
        """Return what speaks against the result, one sentence each."""
        warnings = doubts(self.fitted, self.held_out)
        if len(self.trials):
            warnings += torque_constant_doubts(self.plant, self.trials.split()[0])
        findings = [*judge_pressures(self.trials), *judge_not_fitted(self.trials)]
        return [*warnings, *(f"{row.text}; {row.remedy}" for row in findings)]

    def summary(self) -> str:
        """Return the fitted parameters, and the errors on the held-out trials, as tables."""
        rows = [f"{'parameter':34s}{'value':>11s}{'std. error':>12s}  unit"]
        for q in self.fitted:
            mark = f"  {_mark(q)}" if _mark(q) else ""
            rows.append(f"{q.name:34s}{q.value:11.4g}{q.error or 0:12.2g}  {q.unit}{mark}")
        held_out = len(self.trials.split()[1])
        what = f"{held_out} held-out trials" if held_out else "the fitted trials (none held out)"
        return "\n".join([*rows, "", f"errors on {what}", "", self.held_out.summary()])

    def plot(self) -> Figure:
        """Draw held-out trials, measured and simulated: the smallest and the largest payload."""
        fitted, held_out = self.trials.split()
        return plot_fit(self.plant, held_out or fitted)


def _mark(q: Parameter) -> str:
    """What a reader of the table has to know about a fitted value."""
    if bound := bound_reached(q):
        return f"at its {bound} bound"
    return "weakly determined" if is_weakly_determined(q) else ""


def identify(
    plant: Plant,
    trials: Iterable[Trial],
    report: Report = lambda text: None,
    *,
    servo_gains: Sequence[ServoGains] = (),
    noise_floor: bool = True,
) -> Identification:
    """Fit a plant to trials.

    The trials with the lowest number at the largest amplitude of each motion are fitted; the others
    are held out (`TrialSet.split`).

    Parameters
    ----------
    plant : Plant
        Start of the fit; its values and bounds are the priors.
    trials : TrialSet or iterable of Trial
        Trials of one joint, two joints or both.
    report : callable
        Called with one phrase of progress after each run of all trials.
    servo_gains : sequence of ServoGains
        Gains of the servos in the trials, by joint; empty if unknown. A bundle of the plant then
        runs with these gains only.
    noise_floor : bool
        Whether to measure the noise floor, which `diagnose` compares with, on repeated trials.

    Returns
    -------
    Identification
        Plant with provenance, fitted parameters, and errors on the held-out trials.

    Raises
    ------
    InputError
        If there are no trials, one would spoil the fit or is of another link, or one has more
        joints than the plant or lacks one of its inputs.

    Examples
    --------
    Two trials of the rig, with 0 and 1 kg, identify the nominal plant.

    >>> import dropstitch
    >>> rig, motion = dropstitch.rig_named("default"), dropstitch.Motion()
    >>> cases = [dropstitch.TrialCase(motion, kg, trial=1) for kg in (0.0, 1.0)]
    >>> trials = [dropstitch.run_case(rig, case) for case in cases]
    >>> dropstitch.identify(dropstitch.read_plant(), trials)
    <Identification of 'drop-stitch link, identified': ... tip error 0.8 mm RMS, of a rigid ...>
    """
    trials = TrialSet(tuple(trials))
    if not len(trials):
        raise InputError("trials", "are none", "give at least one")
    refuse_unusable(trials)
    refuse_other_links(plant, plant.where, trials)
    for trial in trials:
        check_duration(trial)
    fit, held_out = trials.split()
    if _planes(fit) > LOADS[plant.load].max_dof:
        raise InputError(
            f"plant {plant.name!r}", "has one joint, a trial has two", "use a plant of the link"
        )
    solve = _fit_link_plant if plant.load == "link" else _fit_from_several_starts
    solution = solve(plant, fit, report)
    result = _with_second_plane(solution.plant, fit)
    fitted = _all_free(result, fit)
    errors = evaluate_plant(result, held_out if len(held_out) else fit)
    provenance = Provenance(
        parent_sha256=plant.sha256(),
        data_sha256=trials.sha256(),
        fitted_trials=plant.provenance.fitted_with(fit),
        held_out_trials=tuple(t.name for t in held_out),
        fitted_parameters=fitted,
        residual_rms=solution.rms,
        held_out=errors,
        servo_gains=tuple(servo_gains),
    )
    name = plant.name.removesuffix(", identified").removesuffix(", nominal")
    result = replace(result, name=f"{name}, identified", provenance=provenance)
    if noise_floor:
        result = with_noise_floor(result, trials)
    return Identification(result, tuple(result.parameters[n] for n in fitted), errors, trials)


def _all_free(plant: Plant, trials: Iterable[Trial]) -> tuple[str, ...]:
    load, drive = free_parameters(plant, trials)
    return tuple(dict.fromkeys(load + drive))


def _planes(trials: Iterable[Trial]) -> int:
    return max(t.meta.dof for t in trials)


# Loads other than the link

DRAWS: Final = 32  # of the prior, for the start of the fit


def _fit_from_several_starts(plant: Plant, trials: Sequence[Trial], report: Report) -> Solution:
    """Best of the fits from the plant itself and from the two best draws of the prior.

    A sticking joint makes the cost discontinuous: its rest position jumps as a parameter changes.
    """
    every_signal = ("",)
    objective = Objective(plant, "twin", trials, _all_free(plant, trials), every_signal)
    normal = np.random.default_rng(0).standard_normal((DRAWS, len(objective.free)))
    drawn = objective.start + objective.prior_deviation * normal
    starts = [objective.start, *np.clip(drawn, objective.low, objective.high)]
    best = np.argsort([_cost(objective, start) for start in starts])[:2]
    report(f"{DRAWS} starts drawn")
    fits = [
        fit_objective(
            objective, starts[k], evaluations=60, tolerance=1e-5,
            report=lambda cost: report(f"cost {cost:.4g}"),
        )
        for k in dict.fromkeys((0, *best))
    ]  # fmt: skip
    return min(fits, key=lambda s: s.cost)


def _cost(objective: Objective, values: Array) -> float:
    residual = objective(values)[0]
    cost = float(residual @ residual)
    return cost if np.isfinite(cost) else np.inf


# The link and its drive

STIFFNESS_SCAN: Final = (0.5, 0.7, 1.0, 1.4, 2.0)  # factors on the initial stiffness


def _fit_link_plant(plant: Plant, trials: Sequence[Trial], report: Report) -> Solution:
    """Fit link and drive in two rounds, see the module's docstring."""
    fewest = min(t.meta.dof for t in trials)
    first = _Round(plant, [t for t in trials if t.meta.dof == fewest], {}, report)
    link = first.fit_link(first.scan_stiffness())
    drive = first.with_servo_options(first.fit_drive(link.plant))
    drive = first.with_alike_servos(drive)

    second = _Round(plant, trials, _angles(drive.rms) | link.rms, report)
    link = second.fit_link(_with_second_plane(drive.plant, first.trials))
    drive = second.with_alike_servos(second.fit_drive(link.plant))
    return drive._replace(rms=_angles(drive.rms) | link.rms)


def _angles(rms: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in rms.items() if name.startswith("angle_")}


@dataclass(frozen=True)
class _Round:
    """Fits of link and drive to some trials.

    The values of `plant` are the centres of the priors; `rms` holds the residual of each signal in
    the round before.
    """

    plant: Plant
    trials: Sequence[Trial]
    rms: Mapping[str, float]
    report: Report

    def scan_stiffness(self) -> Plant:
        """Plant with all stiffness multiplied by the best factor of `STIFFNESS_SCAN`."""
        link, _ = free_parameters(self.plant, self.trials)
        stiffness = [n for n in link if "_stiffness_" in n and n.endswith("_nm_rad")]
        objective = Objective(self.plant, "driven", self.trials, stiffness, LINK_SIGNALS)
        costs: list[tuple[float, Array]] = []
        for factor in STIFFNESS_SCAN:
            values = np.clip(factor * objective.start, objective.low, objective.high)
            costs.append((_cost(objective, values), values))
            self.report(f"stiffness x {factor:g}")
        _, best = min(costs, key=lambda row: row[0])
        return self.plant.with_values(dict(zip(stiffness, best, strict=True)))

    def fit_link(self, start: Plant) -> Solution:
        """Fit the link's parameters while the measured angles drive it."""
        free, _ = free_parameters(start, self.trials)
        objective = Objective(
            start, "driven", self.trials, free, LINK_SIGNALS, self.rms, self.plant
        )
        return self._fit(objective, "link")

    def fit_drive(self, start: Plant) -> Solution:
        """Fit the drive's parameters while the goals drive the twin.

        The smallest, middle and largest payload of each number of joints are enough. The priors of
        the servo's options are their values at the start.
        """
        trials = over_payloads(self.trials, (0.0, 0.5, 1.0))
        _, free = free_parameters(start, self.trials)
        options = [q for n, q in start.parameters.items() if n.startswith(tuple(ABSENT))]
        prior = _with_parameters(self.plant, options)
        signals, rms = ("angle", "position", "current"), _angles(self.rms)
        return self._fit(Objective(start, "twin", trials, free, signals, rms, prior), "drive")

    def _fit(self, objective: Objective, part: str) -> Solution:
        what = f"{part}, {len(objective.trials)} trials"
        return fit_objective(
            objective, evaluations=25, tolerance=1e-3,
            report=lambda cost: self.report(f"{what}: cost {cost:.4g}"),
        )  # fmt: skip

    def best_drive(self, drive: Solution, starts: Sequence[Plant], fall: float) -> Solution:
        """Best fit from further starts if it lowers the cost by this fraction, else `drive`."""
        best = min(map(self.fit_drive, starts), key=lambda s: s.cost, default=drive)
        return best if best.cost < (1 - fall) * drive.cost else drive

    def with_servo_options(self, drive: Solution) -> Solution:
        """Fit with each option that lowers the cost by a tenth [assumed], the best one first."""
        best = self.best_drive(drive, starts_with_option(drive.plant), fall=0.1)
        return drive if best is drive else self.with_servo_options(best)

    def with_alike_servos(self, drive: Solution) -> Solution:
        """Best of the fit and of those in which both servos shape their goals alike."""
        if _planes(self.trials) < 2:
            return drive
        return self.best_drive(drive, starts_with_alike_servos(drive.plant), fall=0.0)


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


def starts_with_option(plant: Plant) -> list[Plant]:
    """Plants with one more option, its parameters free, for each that the plant does not have."""
    result = []
    for start in OPTION_STARTS:
        option = [(p, q) for n, q in plant.parameters.items() for p in start if n.startswith(p)]
        if option and all(q.role == "fixed" and q.value == ABSENT[p] for p, q in option):
            result.append(_with_parameters(plant, [
                msgspec.structs.replace(
                    q, value=start[p], role="nuisance",
                    prior_deviation=q.prior_deviation or start[p],
                )
                for p, q in option
            ]))  # fmt: skip
    return result


def starts_with_alike_servos(plant: Plant) -> list[Plant]:
    """Plants in which both joints' goals have one joint's shape; none if the shapes are alike.

    A servo that holds its goals and one that interpolates them are confused, by the phase at which
    the current is sampled. The servos of one robot usually do the same.
    """
    interpolation = [plant.parameters.get(SHAPE[0].format(j=j)) for j in (1, 2)]
    values = [q.value for q in interpolation if q is not None and q.role != "fixed"]
    if len(values) < 2 or abs(values[0] - values[1]) <= 0.3:  # [assumed]
        return []
    return [
        plant.with_values({n.format(j=b): plant.parameters[n.format(j=a)].value for n in SHAPE})
        for a, b in ((1, 2), (2, 1))
    ]


def _with_parameters(plant: Plant, parameters: Iterable[Parameter]) -> Plant:
    return replace(plant, parameters={**plant.parameters, **{q.name: q for q in parameters}})
