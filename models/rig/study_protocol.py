"""Protocol of the study: settle, warm-up run (discarded), settle, rest, recorded run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_py.errors import InputError
from firmware_py.link.marker_layout import square_layout
from firmware_py.motion import GLIDE_S
from firmware_py.signals import PERIOD_S, trial_signals
from models.rig.rig import Rig, build_rig
from models.rig.rig_parameters import RigParameters
from models.rig.sensors import MarkerLog, read_current, read_encoder, read_markers
from models.rig.trial_case import TrialCase
from models.shared.kinematics import Array
from models.trials.trial import UPRIGHT_M_S2, Trial, TrialMeta

__all__ = ["Variation", "check_link_state", "draw_variation", "run_case"]

REST_SAMPLES: Final = 60
"""Rows at rest before the motion, the reference of the Deformation Index."""

_MARGIN: Final = 6
"""Ticks logged before and after the recorded run, for delay and resampling of the markers."""


@dataclass(frozen=True)
class Variation:
    """Deviation of one trial from the nominal rig."""

    parameters: RigParameters  # With pressure, friction and synchronisation of this trial
    eccentricity_m: tuple[float, float]  # Offset of the payload towards +x and +y
    frame_shift_m: Array  # Shift of the motion capture's frame, (3,)


def draw_variation(
    parameters: RigParameters, case: TrialCase, rng: np.random.Generator
) -> Variation:
    """Draw the variation of one trial: pressure, friction, eccentricity, synchronisation."""
    p = parameters
    pressure, friction, sync, x, y, *shift = rng.standard_normal(8)
    values = {
        "stiffness.pressure_pa": case.pressure_pa
        * (1.0 + p["variation.pressure_share"] * pressure),
        "sensor.mocap_delay_s": p["sensor.mocap_delay_s"] + p["variation.mocap_delay_s"] * sync,
    }
    scale = max(1.0 + p["variation.friction_share"] * friction, 0.0)
    frictions = [name for name in p if name.startswith("servo.") and "_friction_" in name]
    eccentricity = p["variation.eccentricity_m"]
    return Variation(
        parameters=p.scaled(frictions, scale).changed(**values),
        eccentricity_m=(eccentricity * x, eccentricity * y),
        frame_shift_m=p["variation.frame_shift_m"] * np.array(shift),
    )


def run_case(parameters: RigParameters, case: TrialCase) -> Trial:
    """Simulate one trial.

    Parameters
    ----------
    parameters : RigParameters
        Parameters of the rig, with hidden effects.
    case : TrialCase
        Conditions of the trial.

    Raises
    ------
    InputError
        If the payload is negative or not finite, the link folds, the simulation becomes unstable,
        or the integration step does not divide the control period.
    """
    if not 0.0 <= case.payload_kg < math.inf:
        raise InputError("payload_kg", f"is {case.payload_kg:g}", "give 0 or more")
    rng = case.rng()
    variation = draw_variation(parameters, case, rng)
    p = variation.parameters
    rig = build_rig(p, case.motion.dof, case.payload_kg, variation.eccentricity_m, case.gravity)
    substeps = round(PERIOD_S / rig.step_s)
    if abs(substeps * rig.step_s - PERIOD_S) > 1e-9:
        raise InputError(
            p.path, f"world.step_s is {rig.step_s}", f"choose a whole fraction of {PERIOD_S} s"
        )

    # A motion rests before its start and returns to rest after its end, so one run is the warm-up.
    warm_up_s = np.arange(
        -p["world.settle_s"], case.motion.duration_s + GLIDE_S + p["world.pause_s"], PERIOD_S
    )
    before = case.motion.goal_rad(warm_up_s)
    goals = case.motion.table_rad(rest_samples=REST_SAMPLES)
    after = np.repeat(goals[-1:], _MARGIN, axis=0)
    first, last = len(before), len(before) + len(goals)

    encoder_rad, current_a = np.empty_like(goals), np.empty_like(goals)
    log = []
    for tick, goal in enumerate(np.concatenate([before, goals, after])):
        if tick == first:
            rig.start_leak()
        if first <= tick < last:
            encoder_rad[tick - first] = [s.encoder_rad for s in rig.servos]
            current_a[tick - first] = [s.sampled_current_a for s in rig.servos]
        rig.send(goal)
        for _ in range(substeps):
            rig.step()
            if tick >= first - _MARGIN:
                log.append(rig.markers_m.copy())
        check_link_state(rig, case.name, p)

    time_s: Array = PERIOD_S * np.arange(len(goals), dtype=np.float64)
    markers_m = read_markers(
        p, MarkerLog(-_MARGIN * PERIOD_S, rig.step_s, np.array(log)), time_s,
        variation.frame_shift_m, rng,
    )  # fmt: skip
    angle_rad = read_encoder(p, encoder_rad)
    current_a = read_current(p, current_a, rng)
    return _trial(case, p, time_s, goals, angle_rad, current_a, markers_m)


def check_link_state(rig: Rig, where: str, parameters: RigParameters) -> None:
    """Refuse a link that has folded, or a simulation that has become unstable."""
    state = rig.look()
    if state == "folded":
        raise InputError(
            where, f"the link folds {rig.time_s:.1f} s after power-up",
            "choose a smaller payload, amplitude or strength, or a longer period",
        )  # fmt: skip
    if state == "unstable":
        raise InputError(
            where, f"the simulation is unstable {rig.time_s:.1f} s after power-up: its step of "
            f"{parameters['world.step_s']:g} s is too long for parts as light and stiff as these",
            "check masses, stiffness, gear and rotor inertia of link or rig",
        )  # fmt: skip


def _trial(
    case: TrialCase, p: RigParameters, time_s: Array, goal_rad: Array, angle_rad: Array,
    current_a: Array, markers_m: Array,
) -> Trial:  # fmt: skip
    joints = np.stack([goal_rad, angle_rad, current_a], axis=2).reshape(len(time_s), -1)
    tip_m = markers_m[:, p.layout.tip_row].mean(axis=1)
    samples = np.column_stack([time_s, joints, tip_m, markers_m.reshape(len(time_s), -1)])
    motion, size_m = case.motion, (p["link.length_m"], p["link.width_m"])
    meta = TrialMeta(
        dof=motion.dof,
        payload_kg=case.payload_kg,
        pressure_pa=case.pressure_pa,
        trial=case.trial,
        motion=motion.name,
        source="rig",
        period_s=motion.period_s,
        amplitude_rad=motion.amplitude_rad,
        phase_2_rad=motion.phase_2_rad if motion.dof == 2 else 0.0,
        base_offset_m=p["link.base_offset_m"],
        link_length_m=p["link.length_m"],
        link_width_m=p["link.width_m"],
        gravity_m_s2=_gravity_m_s2(case, p),
        markers=p.layout if p.layout != square_layout(*size_m) else None,
        rest_samples=REST_SAMPLES,
    )
    names = [s.name for s in trial_signals(motion.dof, p.layout.count)]
    columns = {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(names)}
    return Trial(case.name, meta, columns)


def _gravity_m_s2(case: TrialCase, p: RigParameters) -> tuple[float, float, float] | None:
    """Gravity in the link's frame; None if it is that of an upright link."""
    x, y, z = case.gravity
    size = p["world.gravity_m_s2"] / math.hypot(x, y, z)
    vector = (x * size, y * size, z * size)
    return None if vector == UPRIGHT_M_S2 else vector
