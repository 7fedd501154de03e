"""Protocol of the study on a rig: settle, warm-up run (discarded), settle, rest, recorded run.

A trial case holds the conditions of a trial; a result depends on its case and rig only. The
conditions that a trial's files lack, hidden effects among them, are recorded beside the trials.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, NamedTuple

import msgspec
import numpy as np

from firmware_py.core.documents import Document, read_document, write_document
from firmware_py.core.errors import InputError
from firmware_py.core.motion import GLIDE_S, STUDY_PERIOD_S, Motion
from firmware_py.core.signals import PERIOD_S, trial_signals
from firmware_py.link.link_description import STUDY_LINK
from firmware_py.link.marker_layout import square_layout
from models.rig.parameters import RigParameters, RigStructure
from models.rig.rig import Load, Rig
from models.rig.sensors import MarkerLog, read_current, read_encoder, read_markers
from models.shared.kinematics import Array
from models.shared.worker_pool import worker_pool
from models.trials.files import write_trial
from models.trials.origin import CONDITIONS_FILE
from models.trials.trial import UPRIGHT_M_S2, Trial, TrialMeta

DOWN: Final = (0.0, 0.0, -1.0)
"""Direction of gravity for an upright robot."""


@dataclass(frozen=True)
class TrialCase:
    """Conditions of one trial to simulate.

    Attributes
    ----------
    motion : Motion
        Reference motion, with the number of driven joints.
    payload_kg : float
        Declared payload in kg.
    trial : int
        Number of the repetition; each has another variation and noise.
    seed : int
        Seed of the whole set of trials.
    pressure_pa : float
        Declared pressure in Pa.
    gravity : tuple of float
        Direction of gravity in the world frame; its length does not matter.

    Examples
    --------
    >>> import dropstitch
    >>> dropstitch.TrialCase(dropstitch.Motion(), payload_kg=1.0, trial=1).name
    'dof1_payload1_trial1_sinusoid_30deg'
    """

    motion: Motion
    payload_kg: float
    trial: int
    seed: int = 0
    pressure_pa: float = STUDY_LINK.pressure_pa
    gravity: tuple[float, float, float] = DOWN

    @property
    def name(self) -> str:
        """Name of the trial; it lists the conditions that differ from the study's."""
        m = self.motion
        parts = [
            f"dof{m.dof}", f"payload{self.payload_kg:g}", f"trial{self.trial}", m.kind,
            f"{math.degrees(m.amplitude_rad):.6g}deg",
        ]  # fmt: skip
        if m.dof == 2 and m.phase_2_rad:
            parts.append(f"phase{math.degrees(m.phase_2_rad):.6g}deg")
        if m.period_s != STUDY_PERIOD_S:
            parts.append(f"period{m.period_s:g}s")
        if self.pressure_pa != STUDY_LINK.pressure_pa:
            parts.append(f"{self.pressure_pa:g}pa")
        if self.gravity != DOWN:
            parts.append("gravity" + ",".join(f"{g:g}" for g in self.gravity))
        return "_".join(parts)

    def rng(self) -> np.random.Generator:
        """Return the trial's random generator, independent of other trials and of the process."""
        return np.random.default_rng([self.seed, zlib.crc32(self.name.encode())])


def build_rig(
    parameters: RigParameters,
    dof: int,
    payload_kg: float,
    eccentricity_m: tuple[float, float] = (0.0, 0.0),
    gravity: tuple[float, float, float] = DOWN,
) -> Rig:
    """Build the engine that the rig's structure names; refuses one that lacks a joint or a choice.

    `eccentricity_m` is the offset of the payload's centre from the axis, towards +x and +y.
    """
    p = parameters
    for joint in (j for j in p.added_in_joint if j > dof):
        raise InputError(
            "--hide EFFECT:JOINT", f"names joint {joint}, and {dof} is driven", "name joint 1"
        )
    x_m, y_m = eccentricity_m
    x_m += p["link.payload_offset_share"] * p["link.length_m"]
    gravity_m_s2 = np.array(gravity) / np.linalg.norm(gravity) * p["world.gravity_m_s2"]
    load = Load(payload_kg, x_m, y_m, gravity_m_s2)
    # An engine is loaded when it is built: each needs a large library.
    if p.structure.engine == "cosserat":
        try:
            from models.rig.rod import CosseratRig
        except ModuleNotFoundError as error:
            raise InputError(
                "the engine cosserat", f"needs the package {error.name}",
                "pip install 'dropstitch[rod]', or make setup",
            ) from None  # fmt: skip
        return CosseratRig(p, dof, load)
    from models.rig.hinged import MujocoRig

    return MujocoRig(p, dof, load)


class Variation(NamedTuple):
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
    scale = max(1.0 + p["variation.friction_share"] * friction, 0.0)
    varied = p.scaled([n for n in p if n.startswith("servo.") and "_friction_" in n], scale)
    varied = varied.changed(**{
        "stiffness.pressure_pa":
            case.pressure_pa * (1.0 + p["variation.pressure_share"] * pressure),
        "sensor.mocap_delay_s": p["sensor.mocap_delay_s"] + p["variation.mocap_delay_s"] * sync,
    })  # fmt: skip
    eccentricity = p["variation.eccentricity_m"]
    shift_m = p["variation.frame_shift_m"] * np.array(shift)
    return Variation(varied, (eccentricity * x, eccentricity * y), shift_m)


REST_SAMPLES: Final = 60
"""Rows at rest before the motion, the reference of the Deformation Index."""

_MARGIN: Final = 6
"""Ticks logged before and after the recorded run, for delay and resampling of the markers."""


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

    Examples
    --------
    A quick one, for which the rig pauses less than the study's protocol asks:

    >>> import dropstitch
    >>> rig = dropstitch.rig_named("default")
    >>> rig = rig.changed(**{"world.pause_s": 0.1, "world.settle_s": 0.1})
    >>> motion = dropstitch.Motion(period_s=1.0, amplitude_rad=0.05)
    >>> case = dropstitch.TrialCase(motion, payload_kg=0.5, trial=1)
    >>> trial = dropstitch.run_case(rig, case)
    >>> trial.columns["tip_x_m"].shape == (len(trial),)
    True
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
        rig.check_link(case.name)

    time_s: Array = PERIOD_S * np.arange(len(goals), dtype=np.float64)
    markers_m = read_markers(
        p, MarkerLog(-_MARGIN * PERIOD_S, rig.step_s, np.array(log)), time_s,
        variation.frame_shift_m, rng,
    )  # fmt: skip
    angle_rad = read_encoder(p, encoder_rad)
    current_a = read_current(p, current_a, rng)
    joints = np.stack([goals, angle_rad, current_a], axis=2).reshape(len(time_s), -1)
    tip_m = markers_m[:, p.layout.tip_row].mean(axis=1)
    samples = np.column_stack([time_s, joints, tip_m, markers_m.reshape(len(time_s), -1)])
    names = [s.name for s in trial_signals(case.motion.dof, p.layout.count)]
    columns = {name: np.ascontiguousarray(samples[:, k]) for k, name in enumerate(names)}
    return Trial(case.name, _meta(case, p), columns)


def _meta(case: TrialCase, p: RigParameters) -> TrialMeta:
    motion, size_m = case.motion, (p["link.length_m"], p["link.width_m"])
    x, y, z = case.gravity
    size = p["world.gravity_m_s2"] / math.hypot(x, y, z)
    gravity = (x * size, y * size, z * size)
    return TrialMeta(
        dof=motion.dof,
        payload_kg=case.payload_kg,
        pressure_pa=case.pressure_pa,
        trial=case.trial,
        motion=motion.kind,
        source="rig",
        period_s=motion.period_s,
        amplitude_rad=motion.amplitude_rad,
        phase_2_rad=motion.phase_2_rad if motion.dof == 2 else 0.0,
        base_offset_m=p["link.base_offset_m"],
        link_length_m=p["link.length_m"],
        link_width_m=p["link.width_m"],
        gravity_m_s2=None if gravity == UPRIGHT_M_S2 else gravity,
        markers=p.layout if p.layout != square_layout(*size_m) else None,
        rest_samples=REST_SAMPLES,
    )


def run_trial_cases(
    cases: Sequence[TrialCase],
    parameters: RigParameters,
    directory: Path,
    workers: int,
    on_done: Callable[[str], None],
) -> list[Path]:
    """Simulate and write every case; return the CSV files in the order of the cases.

    `on_done` is called with the name of each trial after it is written.
    """
    if workers == 1 or len(cases) == 1:
        paths = []
        for case in cases:
            paths.append(_run_and_write(parameters, case, directory))
            on_done(case.name)
        return paths
    with worker_pool(min(workers, len(cases))) as pool:
        futures = {
            pool.submit(_run_and_write, parameters, case, directory): case.name for case in cases
        }
        for future in as_completed(futures):
            future.result()
            on_done(futures[future])
    return [future.result() for future in futures]


def _run_and_write(parameters: RigParameters, case: TrialCase, directory: Path) -> Path:
    return write_trial(run_case(parameters, case), directory)


class RigConditions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Conditions of a trial that its files do not contain."""

    seed: int  # Seed of variation and noise
    hidden: dict[str, float]  # Strength of each hidden effect, in its unit
    rig_sha256: str  # Hash of the rig's structure and parameters, hidden effects included
    rig: str  # Name of the rig, or its file
    structure: RigStructure  # Forms of the rig's equations


class ConditionsRecord(Document, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conditions of simulated trials."""

    MADE_BY: ClassVar[str] = "dropstitch simulate"

    trials: dict[str, RigConditions]  # Conditions by name of the trial


def record_conditions(
    cases: Sequence[TrialCase], conditions: RigConditions, directory: Path
) -> None:
    """Add the conditions of these trials to the directory's record, before they are simulated.

    Refuses to overwrite a trial that was measured or simulated under other conditions.
    """
    path = directory / CONDITIONS_FILE
    recorded = read_document(path, ConditionsRecord).trials if path.exists() else {}
    for case in cases:
        trial = directory / f"{case.name}.csv"
        if trial.exists() and recorded.get(case.name) != conditions:
            raise InputError(
                trial,
                "holds a trial that was run under other conditions",
                "choose another --out, or remove it",
            )
    directory.mkdir(parents=True, exist_ok=True)
    trials = recorded | {case.name: conditions for case in cases}
    record = ConditionsRecord(schema=ConditionsRecord.VERSION, trials=dict(sorted(trials.items())))
    write_document(path, record)
