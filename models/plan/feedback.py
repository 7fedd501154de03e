"""Gain and phase margin of a loop by its frequency response; the highest gain for given margins.

Feedback of the estimated tip: filters shaped on the linearised twin for each payload.

The loop of a joint is filter, integrator, delay and twin::

    L(z) = F(z) · h/(z − 1) · P(z)

The integrator is the correction itself; one period of delay stands for the loop and the bus. F is a
gain and a notch at the first mode of the link, whose frequency falls with the payload: without it
the mode limits the gain. The estimate of the tip is assumed exact: the observer is the twin's own
link, driven by the measured angles. Loop shaping with python-control: the gain is the highest with
which all linearisations at that payload keep the margins, at rest and sliding, and with a link 20 %
stiffer or softer than the plant.

Changes of a plan by a stiffer link: goals, currents, and the observer's error.

Feedback of an inverted plan: loops for its grid, and the changes by a stiffer link.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import control
import msgspec
import numpy as np
from numpy.typing import NDArray

from firmware_py.errors import InputError
from firmware_py.goals.feedback_design import (
    Columns,
    FeedbackDesign,
    LoopMargins,
    RateFilter,
    StiffnessSlopes,
)
from firmware_py.goals.plan_goals import check_plan_goals
from firmware_py.goals.tip_plan import TipPlan, as_columns
from firmware_py.safety.limits import Limits
from models.plan.inversion import Inverse, Inverter
from models.plan.tip_twin import TipTwin
from models.plant.linear_twin import (
    DRY_FRICTION,
    STIFFNESS,
    LinearTwins,
    frequency_response,
    modes,
    tip_part,
)
from models.plant.plant import Plant
from models.plant.simulation.runner import CompiledModel
from models.plant.step_model import names

Array = NDArray[np.float64]
Response = NDArray[np.complex128]
LEAST_GAIN_DB: Final = 6.0
LEAST_PHASE_RAD: Final = float(np.radians(45.0))
"""Margins that every loop must keep (requirement)."""


def gain_margin(loop: Response) -> float:
    """Factor by which the gain may rise until the loop is unstable; infinite if it never is.

    The loop is an integrator around a stable plant, so it is stable at small gain. It stays stable
    up to the least gain at which its response reaches −1.

    Shapes: `loop` (n,).
    """
    imag = loop.imag
    at = np.flatnonzero(imag[:-1] * imag[1:] <= 0.0)
    place = _between(loop, at, imag[:-1], imag[1:]).real
    largest = float(np.max(-place, initial=0.0))
    return np.inf if largest == 0.0 else 1.0 / largest


def phase_margin_rad(loop: Response) -> float:
    """Least distance of the phase from −180° where the gain is 1; infinite if it never is.

    Shapes: `loop` (n,).
    """
    size = np.abs(loop)
    at = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) <= 0.0)
    place = _between(loop, at, size[:-1] - 1.0, size[1:] - 1.0)
    return float(np.min(np.abs(np.angle(-place)), initial=np.inf))


def crossover_rad_s(loop: Response, rates_rad_s: Array) -> float:
    """Lowest frequency at which the gain falls below 1.

    Shapes: `loop` (n,), `rates_rad_s` (n,).
    """
    size = np.abs(loop)
    after = int(np.argmax(size < 1.0))
    if after == 0:
        return float(rates_rad_s[0])
    own = slice(after - 1, after + 1)
    return float(np.interp(-1.0, -size[own], rates_rad_s[own]))


def highest_gain(loops: list[Response], gain_db: float, phase_rad: float) -> float:
    """Highest factor on every loop with which all keep the margins; 0 if there is none."""
    by_gain = min(gain_margin(loop) for loop in loops) * 10.0 ** (-gain_db / 20.0)
    for factor in min(by_gain, 1e6) * np.geomspace(1.0, 1e-3, 120):
        if all(phase_margin_rad(factor * loop) >= phase_rad for loop in loops):
            return float(factor)
    return 0.0


def _between(loop: Response, at: NDArray[np.intp], before: Array, after: Array) -> Response:
    """Response at the zeros of a quantity, interpolated linearly within each interval."""
    change = before[at] - after[at]
    part = np.divide(before[at], change, out=np.zeros(len(at)), where=change != 0.0)
    return np.asarray(loop[at] + part * (loop[at + 1] - loop[at]))


SIZE_RAD: Final = 0.03
"""Largest correction [assumed]: 3 cm at the tip, half of the error of rigid kinematics."""
RATE_RAD_S: Final = 0.16
"""Largest rate of a correction: the largest one fades out within 0.2 s."""
INNOVATION_A: Final = 0.25
"""Innovation of a current above which the estimate is not trusted. Measured on the rig with 1.3 kg,
circle of 0.45 m in 6 s: 0.05 A, 0.07 A where the link is a fifth stiffer than the plant, 0.34 A
with 0.5 kg that the robot has no information of, whose tip is 10 mm off its path."""
SPARE_DB: Final = 0.5
SPARE_RAD: Final = float(np.radians(3.0))
"""Margin beyond the required one, for payloads between those of the grid [assumed]."""
VARIANTS: Final = ((True, 1.0), (False, 1.0), (True, 0.8), (True, 1.2))
"""Linearisations at a payload: whether sliding or at rest, and factor on the link's stiffness."""
DEPTHS: Final = (0.1, 0.2, 0.35)
WIDTHS: Final = (0.5, 0.8, 1.2, 1.8)
PLACES: Final = (0.95, 1.0, 1.1)
"""Notches that are tried: damping of numerator and denominator, frequency over that of the mode."""
LIGHT: Final = 0.3
"""Damping ratio below which a mode belongs to the link."""


@dataclass(frozen=True)
class ShapedLoops:
    """Loops of one joint at one payload, for pictures."""

    joint: int
    payload_kg: float
    rates_rad_s: Array  # (n,)
    responses: list[Response]  # One per linearisation of `VARIANTS`


def frequencies(period_s: float) -> Array:
    """Angular frequencies at which loops are evaluated, up to Nyquist's."""
    end = np.pi / period_s
    return np.concatenate([np.geomspace(0.05, 2.0, 50), np.arange(2.05, 30.0, 0.05),
                           np.linspace(30.0, 0.999 * end, 40)])  # fmt: skip


def design_feedback(
    plant: Plant, dof: int, period_s: float, payloads_kg: Sequence[float]
) -> FeedbackDesign:
    twins = LinearTwins(plant, dof, period_s)
    filters: list[tuple[RateFilter, ...]] = []
    responses = {payload_kg: _responses(twins, payload_kg) for payload_kg in payloads_kg}
    for payload_kg, plants in responses.items():
        mode_rad_s = _link_mode_rad_s(twins, payload_kg)
        filters.append(
            tuple(_shaped([p[:, j, j] for p in plants], mode_rad_s, period_s) for j in range(dof))
        )
    design = FeedbackDesign(
        filters=tuple(filters), margins=(), size_rad=SIZE_RAD, rate_rad_s=RATE_RAD_S,
        innovation_a=INNOVATION_A,
    )  # fmt: skip
    loops = _opened(design, period_s, responses)
    return msgspec.structs.replace(design, margins=_margins(loops, dof))


def margins_of(
    design: FeedbackDesign, twins: LinearTwins, payloads_kg: Sequence[float]
) -> tuple[tuple[LoopMargins, ...], ...]:
    """Least margins of each loop at each payload, with the other loop closed."""
    return _margins(shaped_loops(design, twins, payloads_kg), twins.dof)


def _margins(loops: Sequence[ShapedLoops], dof: int) -> tuple[tuple[LoopMargins, ...], ...]:
    return tuple(
        tuple(
            LoopMargins(
                payload_kg=own.payload_kg,
                gain_db=20.0 * float(np.log10(min(map(gain_margin, own.responses)))),
                phase_rad=min(map(phase_margin_rad, own.responses)),
                crossover_rad_s=crossover_rad_s(own.responses[0], own.rates_rad_s),
            )
            for own in loops
            if own.joint == joint
        )
        for joint in range(1, dof + 1)
    )


def shaped_loops(
    design: FeedbackDesign, twins: LinearTwins, payloads_kg: Sequence[float]
) -> list[ShapedLoops]:
    """Responses of the loops by payload and joint, each opened with the other one closed."""
    responses = {payload_kg: _responses(twins, payload_kg) for payload_kg in payloads_kg}
    return _opened(design, twins.period_s, responses)


def _opened(
    design: FeedbackDesign, period_s: float,
    plants_by_payload: Mapping[float, Sequence[NDArray[np.complex128]]],
) -> list[ShapedLoops]:  # fmt: skip
    rates = frequencies(period_s)
    found = []
    for (payload_kg, plants), filters in zip(
        plants_by_payload.items(), design.filters, strict=True
    ):
        shapes = [_integrated(as_system(f, period_s), rates) for f in filters]
        for j, own in enumerate(shapes):
            responses = []
            for p in plants:
                seen = p[:, j, j]
                if len(shapes) == 2:
                    o = 1 - j
                    closed = shapes[o] / (1.0 + shapes[o] * p[:, o, o])
                    seen = seen - p[:, j, o] * closed * p[:, o, j]
                responses.append(own * seen)
            found.append(ShapedLoops(j + 1, payload_kg, rates, responses))
    return found


def as_system(own: RateFilter, period_s: float) -> control.StateSpace:
    """Filter as a python-control system."""
    return control.ss(*(np.array(m) for m in (own.a, own.b, own.c, own.d)), period_s)


def keeps_margins(design: FeedbackDesign) -> bool:
    """Whether every loop keeps the required margins."""
    return all(
        m.gain_db >= LEAST_GAIN_DB and m.phase_rad >= LEAST_PHASE_RAD
        for own in design.margins
        for m in own
    )


def _responses(twins: LinearTwins, payload_kg: float) -> list[NDArray[np.complex128]]:
    rates = frequencies(twins.period_s)
    return [
        frequency_response(
            tip_part(twins.at(payload_kg, sliding=sliding, stiffness=factor), twins.dof), rates
        )
        for sliding, factor in VARIANTS
    ]


def _link_mode_rad_s(twins: LinearTwins, payload_kg: float) -> float:
    light = [m for m in modes(twins.at(payload_kg)) if m.damping < LIGHT]
    return light[0].frequency_rad_s if light else 0.25 * np.pi / twins.period_s


def _integrated(own: control.StateSpace, rates_rad_s: Array) -> Response:
    """Response of filter, integrator and the period of delay."""
    z = np.exp(1j * rates_rad_s * own.dt)
    return np.asarray(frequency_response(own, rates_rad_s)[:, 0, 0] * own.dt / (z - 1.0))


def _shaped(plants: list[Response], mode_rad_s: float, period_s: float) -> RateFilter:
    """Notch and gain with the highest crossover that keeps the margins."""
    rates = frequencies(period_s)
    best: tuple[float, RateFilter] | None = None
    for depth, width, place in product(DEPTHS, WIDTHS, PLACES):
        w = place * mode_rad_s
        notch = control.tf([1.0, 2 * depth * w, w * w], [1.0, 2 * width * w, w * w])
        own = control.ss(control.sample_system(notch, period_s, "tustin"))
        shape = _integrated(own, rates)
        loops = [shape * p for p in plants]
        gain = highest_gain(loops, LEAST_GAIN_DB + SPARE_DB, LEAST_PHASE_RAD + SPARE_RAD)
        if gain > 0.0 and (best is None or gain > best[0]):
            a, b, c, d = (_rows(m) for m in (own.A, own.B, gain * own.C, gain * own.D))
            best = gain, RateFilter(a=a, b=b, c=c, d=d)
    if best is None:  # a plant without gain: only zero feedback keeps the margins
        return RateFilter(a=((0.0,),), b=((0.0,),), c=((0.0,),), d=((0.0,),))
    return best[1]


def _rows(matrix: Array) -> Columns:
    return tuple(tuple(row) for row in np.asarray(matrix, dtype=np.float64).tolist())


STIFFER: Final = 0.2
"""Relative change of stiffness over which the differences are taken: the one a plan
must tolerate."""
MORE_FRICTION: Final = 0.2
"""The same for friction [assumed]."""
DECIMALS: Final = 5
"""Digits of the differences in the document: of goals 10 µrad, of the tip 10 µm."""
MOVING_RAD_S: Final = 0.1
"""Joint rate at which a sample has half its weight: the observer's `learning_rate_rad_s`."""


def stiffness_slopes(
    plant: Plant, twin: TipTwin, inverter: Inverter, found: Inverse, driven: CompiledModel
) -> StiffnessSlopes:
    """Differentiate a plan for one payload by the relative stiffness of the link.

    `driven`: the link of the observer, driven by measured angles at a known payload.
    """
    changes = {
        n: (1.0 + STIFFER) * p.value for n, p in plant.parameters.items() if n.startswith(STIFFNESS)
    }
    rubbing = {
        n: (1.0 + MORE_FRICTION) * p.value
        for n, p in plant.parameters.items()
        if n.startswith((*DRY_FRICTION, "viscous_friction_"))
    }
    stiffer = twin.changed(changes)
    same = stiffer.run(found.goals_rad, found.payload_kg)
    follows = inverter.on(stiffer).invert_from(found)
    friction = twin.changed(rubbing).run(found.goals_rad, found.payload_kg)
    currents = twin.current_a(found.outputs)
    seen = _seen_tip_m(driven, twin, follows) - _seen_tip_m(driven, twin, found)
    moved = twin.tip_m(follows.outputs) - twin.tip_m(found.outputs)
    rate = np.gradient(twin.angle_rad(found.outputs), twin.period_s, axis=0)
    return StiffnessSlopes(
        goals_rad=as_columns((follows.goals_rad - found.goals_rad) / STIFFER, DECIMALS),
        current_a=as_columns((twin.current_a(follows.outputs) - currents) / STIFFER, DECIMALS),
        unmatched_a=as_columns((twin.current_a(same) - currents) / STIFFER, DECIMALS),
        friction_a=as_columns((twin.current_a(friction) - currents) / MORE_FRICTION, DECIMALS),
        weight=as_columns(rate**2 / (rate**2 + MOVING_RAD_S**2), DECIMALS),
        unseen_m=as_columns((moved - seen) / STIFFER, DECIMALS),
    )


def _seen_tip_m(driven: CompiledModel, twin: TipTwin, own: Inverse) -> Array:
    """Tip of the observer's link for the joint angles of a run, shape (n, dof)."""
    angle = twin.angle_rad(own.outputs)
    u = np.column_stack([angle, np.full(len(angle), own.payload_kg)])
    p = driven.model.parameter_values()
    y = driven.simulate(u[1:], twin.period_s, p, driven.start(u[0], p))
    places = [names(driven.model.outputs).index(n) for n in ("tip_x_m", "tip_y_m")[: twin.dof]]
    return y[:, places]


def with_feedback(
    plan: TipPlan, plant: Plant, limits: Limits, twin: TipTwin, inverter: Inverter,
    found: Sequence[Inverse],
) -> tuple[TipPlan, str]:  # fmt: skip
    """Add feedback; if that is impossible, return the plan unchanged, and the reason.

    Feedback needs loops that keep the margins, and limits that leave room for corrections.
    """
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
        msgspec.structs.replace(
            own, stiffness=stiffness_slopes(plant, twin, inverter, inverse, driven)
        )
        for own, inverse in zip(plan.payloads, found, strict=True)
    )
    return msgspec.structs.replace(guided, payloads=payloads), ""
