"""Feedback of the estimated tip in a plan, shaped on the linearised twin for each payload.

The loop of a joint is filter, integrator, delay and twin::

    L(z) = F(z) · h/(z − 1) · P(z)

The integrator is the correction itself; one period of delay stands for the loop and the bus. F is a
gain and a notch at the first mode of the link, whose frequency falls with the payload: without it
the mode limits the gain. The estimate of the tip is assumed exact: the observer has the twin's
link, driven by the measured angles. The gain is the highest with which all linearisations at that
payload keep the margins, at rest and sliding, and with a link 20 % stiffer or softer than the
plant.

Feedback cannot see a link that is stiffer than its plant, because the observer has the plant's
stiffness. So a plan also holds what such a link changes: goals, currents, and the observer's error.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Final

import control
import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import (
    Columns,
    FeedbackDesign,
    LoopMargins,
    RateFilter,
    StiffnessSlopes,
    TipPlan,
    as_columns,
)
from firmware_py.safety.limits import Limits
from models.plan.inversion import Inverter
from models.plan.tip_twin import MOVING_RAD_S, TipTwin, TwinRun
from models.plant.linear_twin import DRY_FRICTION, STIFFNESS, LinearTwins, link_modes, tip_part
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

Array = NDArray[np.float64]
Response = NDArray[np.complex128]
LEAST_GAIN_DB: Final = 6.0
LEAST_PHASE_RAD: Final = float(np.radians(45.0))
"""Margins that every loop must keep (requirement)."""
SPARE_DB: Final = 0.5
SPARE_RAD: Final = float(np.radians(3.0))
"""Margin beyond the required one, for payloads between those of the grid [assumed]."""
SIZE_RAD: Final = 0.03
"""Largest correction [assumed]: 3 cm at the tip, half of the error of rigid kinematics."""
RATE_RAD_S: Final = 0.16
"""Largest rate of a correction: the largest one fades out within 0.2 s."""
INNOVATION_A: Final = 0.25
"""Innovation of a current above which the estimate is not trusted. Measured on the rig with 1.3 kg,
circle of 0.45 m in 6 s: 0.05 A, 0.07 A where the link is a fifth stiffer than the plant, 0.34 A
with 0.5 kg that the robot has no information of, whose tip is 10 mm off its path."""
VARIANTS: Final = ((True, 1.0), (False, 1.0), (True, 0.8), (True, 1.2))
"""Linearisations at a payload: whether sliding or at rest, and factor on the link's stiffness."""
DEPTHS: Final = (0.1, 0.2, 0.35)
WIDTHS: Final = (0.5, 0.8, 1.2, 1.8)
PLACES: Final = (0.95, 1.0, 1.1)
"""Notches that are tried: damping of numerator and denominator, frequency over that of the mode."""
CHANGE: Final = 0.2
"""Relative change of stiffness and of friction over which a plan is differentiated: a plan must
tolerate a link as much stiffer."""


def with_feedback(
    plan: TipPlan, plant: Plant, limits: Limits, twin: TipTwin, inverter: Inverter,
    runs: Sequence[TwinRun],
) -> tuple[TipPlan, str]:  # fmt: skip
    """Plan with feedback; if that is impossible, the unchanged plan, and the reason."""
    design = design_feedback(plant, plan.dof, plan.period_s, plan.grid_kg.tolist())
    if not keeps_margins(design):
        return plan, "no gain of a loop keeps its margins"
    guided = msgspec.structs.replace(plan, feedback=design)
    try:
        check_plan_goals(guided, limits, f"path {plan.path}")
    except InputError as error:
        return plan, f"the limits leave no room for corrections ({error})"
    driven = CompiledModel(plant.step_model(plan.dof, "driven"))
    payloads = tuple(
        msgspec.structs.replace(one, stiffness=_stiffness_slopes(twin, inverter, run, driven))
        for one, run in zip(plan.payloads, runs, strict=True)
    )
    return msgspec.structs.replace(guided, payloads=payloads), ""


def design_feedback(
    plant: Plant, dof: int, period_s: float, payloads_kg: Sequence[float]
) -> FeedbackDesign:
    twins = LinearTwins(plant.step_model(dof), period_s)
    filters, margins = [], []
    for payload_kg in payloads_kg:
        plants = tip_responses(twins, payload_kg)
        modes = link_modes(twins.at(payload_kg))
        notches = [m.frequency_rad_s for m in modes] or [0.25 * np.pi / period_s] * dof
        filters.append(
            tuple(_shaped([p[j, j] for p in plants], notches[j], period_s) for j in range(dof))
        )
        loops = open_loops(filters[-1], plants, period_s)
        margins.append([_margins(loop, payload_kg, period_s) for loop in loops])
    return FeedbackDesign(
        filters=tuple(filters), margins=tuple(zip(*margins, strict=True)), size_rad=SIZE_RAD,
        rate_rad_s=RATE_RAD_S, innovation_a=INNOVATION_A,
    )  # fmt: skip


def keeps_margins(design: FeedbackDesign) -> bool:
    return all(
        m.gain_db >= LEAST_GAIN_DB and m.phase_rad >= LEAST_PHASE_RAD
        for of_joint in design.margins
        for m in of_joint
    )


def frequencies(period_s: float) -> Array:
    """Angular frequencies at which loops are evaluated, up to Nyquist's."""
    end = np.pi / period_s
    return np.concatenate([np.geomspace(0.05, 2.0, 50), np.arange(2.05, 30.0, 0.05),
                           np.linspace(30.0, 0.999 * end, 40)])  # fmt: skip


def tip_responses(twins: LinearTwins, payload_kg: float) -> list[Response]:
    """Responses of the tip to the goals, one per linearisation, shape (dof, dof, n) each."""
    z = np.exp(1j * frequencies(twins.period_s) * twins.period_s)
    return [
        tip_part(twins.at(payload_kg, sliding=sliding, stiffness=factor))(z, squeeze=False)
        for sliding, factor in VARIANTS
    ]


def open_loops(
    filters: Sequence[RateFilter], plants: Sequence[Response], period_s: float
) -> list[list[Response]]:
    """Loop of each joint for each linearisation, opened with the other joint's closed."""
    shapes = [_integrated(as_system(f, period_s), period_s) for f in filters]
    loops: list[list[Response]] = [[] for _ in shapes]
    for j, shape in enumerate(shapes):
        for p in plants:
            path = p[j, j]
            for o in {0, 1} - {j} if len(shapes) == 2 else ():
                closed = shapes[o] / (1.0 + shapes[o] * p[o, o])
                path = path - p[j, o] * closed * p[o, j]
            loops[j].append(shape * path)
    return loops


def _shaped(plants: Sequence[Response], mode_rad_s: float, period_s: float) -> RateFilter:
    """Notch and gain with the highest crossover that keeps the margins."""
    notches = []
    for depth, width, place in product(DEPTHS, WIDTHS, PLACES):
        w = place * mode_rad_s
        notch = control.tf([1.0, 2 * depth * w, w * w], [1.0, 2 * width * w, w * w])
        notch = control.sample_system(notch, period_s, "tustin")
        shape = _integrated(notch, period_s)
        notches.append((highest_gain([shape * p for p in plants]), notch))
    gain, best = max(notches, key=lambda one: one[0])
    notch = control.ss(best)
    a, b, c, d = (
        tuple(tuple(row) for row in np.asarray(m, dtype=np.float64).tolist())
        for m in (notch.A, notch.B, gain * notch.C, gain * notch.D)
    )
    return RateFilter(a=a, b=b, c=c, d=d)


def _integrated(filter_: control.lti.LTI, period_s: float) -> Response:
    """Response of filter, integrator and the period of delay, shape (n,)."""
    z = np.exp(1j * frequencies(period_s) * period_s)
    return np.asarray(filter_(z) * period_s / (z - 1.0))


def highest_gain(loops: Sequence[Response]) -> float:
    """Highest factor on every loop with which all keep the margins, some to spare; 0 for none.

    A loop keeps its phase margin if its gain is below 1 wherever its phase is nearer to −180° than
    the margin, and its gain margin if the gain is below that margin's inverse at −180°.
    """
    limit = 1e6
    for loop in loops:
        size, apart_rad = np.abs(loop), np.angle(-loop)
        near = size[np.abs(apart_rad) < LEAST_PHASE_RAD + SPARE_RAD]
        crossing = np.diff(np.signbit(apart_rad)) & (np.abs(apart_rad[1:]) < 0.5 * np.pi)
        at_180 = np.maximum(size[1:], size[:-1])[crossing]
        margin = float(10.0 ** ((LEAST_GAIN_DB + SPARE_DB) / 20.0))
        largest = max(near.max(initial=0.0), margin * at_180.max(initial=0.0))
        limit = min(limit, 1.0 / largest if largest else limit)
    return limit


def as_system(filter_: RateFilter, period_s: float) -> control.StateSpace:
    matrices = (filter_.a, filter_.b, filter_.c, filter_.d)
    return control.ss(*(np.array(m) for m in matrices), period_s)


def _margins(loop: Sequence[Response], payload_kg: float, period_s: float) -> LoopMargins:
    """Least margins over the linearisations, and the crossover of the sliding one.

    The loop is an integrator around a stable plant, so it is stable at small gain, and stays so up
    to the least gain at which its response reaches −1.
    """
    rates = frequencies(period_s)
    margins = [control.stability_margins(control.frd(r, rates), returnall=True) for r in loop]
    gains, phases_deg = (np.concatenate([m[k] for m in margins]) for k in (0, 1))
    return LoopMargins(
        payload_kg=payload_kg,
        gain_db=20.0 * float(np.log10(gains.min(initial=np.inf))),
        phase_rad=float(np.radians(np.abs(phases_deg).min(initial=np.inf))),
        crossover_rad_s=float(margins[0][4].min(initial=rates[-1])),
    )


def _stiffness_slopes(
    twin: TipTwin, inverter: Inverter, run: TwinRun, driven: CompiledModel
) -> StiffnessSlopes:
    """Derivatives of a plan for one payload by the relative stiffness of the link.

    `driven`: the link of the observer, driven by measured angles at a known payload.
    """
    stiffer = twin.scaled({STIFFNESS: 1.0 + CHANGE})
    rubbing = twin.scaled({(*DRY_FRICTION, "viscous_friction_"): 1.0 + CHANGE})
    follows = inverter.invert_on(stiffer, run)
    unmatched, friction = (
        other.run(run.goals_rad, run.payload_kg).current_a for other in (stiffer, rubbing)
    )
    estimated = _estimated_tip_m(driven, twin, follows) - _estimated_tip_m(driven, twin, run)
    rate = np.gradient(run.angle_rad, twin.period_s, axis=0)

    def slope(change: Array) -> Columns:
        return as_columns(change / CHANGE, 5)  # goals to 10 µrad, the tip to 10 µm

    return StiffnessSlopes(
        goals_rad=slope(follows.goals_rad - run.goals_rad),
        current_a=slope(follows.current_a - run.current_a),
        unmatched_a=slope(unmatched - run.current_a),
        friction_a=slope(friction - run.current_a),
        weight=as_columns(rate**2 / (rate**2 + MOVING_RAD_S**2), 5),
        unseen_m=slope(follows.tip_m - run.tip_m - estimated),
    )


def _estimated_tip_m(driven: CompiledModel, twin: TipTwin, run: TwinRun) -> Array:
    """Tip of the observer's link for the joint angles of a run, shape (n, dof)."""
    u = np.column_stack([run.angle_rad, np.full(len(run.angle_rad), run.payload_kg)])
    p = driven.model.parameter_values()
    y = driven.simulate(u[1:], twin.period_s, p, driven.start(u[0], p))
    places = [names(driven.model.outputs).index(n) for n in ("tip_x_m", "tip_y_m")[: twin.dof]]
    return y[:, places]
