"""Sensors of the rig: encoder and current of the servo, markers of the motion capture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from models.rig.parameters import RigParameters
from models.shared.kinematics import Array


class MarkerLog(NamedTuple):
    """True markers on a fine uniform grid: `markers_m[k]` (markers, 3) at `start_s + k step_s`."""

    start_s: float
    step_s: float
    markers_m: Array

    def at(self, time_s: Array) -> Array:
        """Markers at times within the log, interpolated linearly, shape (n, markers, 3)."""
        position = (time_s - self.start_s) / self.step_s
        before = np.clip(position.astype(int), 0, len(self.markers_m) - 2)
        fraction = (position - before)[:, None, None]
        return np.asarray(
            self.markers_m[before] * (1.0 - fraction) + self.markers_m[before + 1] * fraction
        )


def read_encoder(parameters: RigParameters, encoder_rad: Array) -> Array:
    """Angle of the rotor at the output in rad, rounded to whole pulses as the servo reports it."""
    pulse = 2.0 * np.pi / parameters["sensor.pulses_per_turn"]
    return np.asarray(np.round(encoder_rad / pulse) * pulse)


def read_current(parameters: RigParameters, current_a: Array, rng: np.random.Generator) -> Array:
    """Current in A with scale error, bias and noise, rounded to whole counts."""
    p = parameters
    joints = [p.of_joint(k + 1) for k in range(current_a.shape[-1])]
    scale = np.array([1.0 + q["sensor.current_scale_share"] for q in joints])
    read = current_a * scale + np.array([q["sensor.current_bias_a"] for q in joints])
    read = read + p["sensor.current_noise_a"] * rng.standard_normal(current_a.shape)
    return np.asarray(np.round(read / p["sensor.current_step_a"]) * p["sensor.current_step_a"])


def read_markers(
    parameters: RigParameters,
    log: MarkerLog,
    time_s: Array,
    shift_m: Array,
    rng: np.random.Generator,
) -> Array:
    """Markers at `time_s` (n,) as the motion capture gives them, shape (n, markers, 3).

    The cameras are not synchronised; every frame has marker noise and timing jitter. A frame at
    time t shows the markers of one delay earlier. Frames are filtered, resampled and put into the
    world frame of the motion capture, with its tilt, scale and shift.
    """
    p = parameters
    interval_s = 1.0 / p["sensor.mocap_rate_hz"]
    count = int((time_s[-1] - time_s[0]) / interval_s) + 4
    frames_s = time_s[0] + (rng.uniform() - 2.0 + np.arange(count)) * interval_s
    jitter_s = p["sensor.mocap_jitter_s"] * rng.standard_normal(count)
    frames_m = log.at(frames_s - p["sensor.mocap_delay_s"] + jitter_s)
    frames_m = frames_m + p["sensor.marker_noise_m"] * rng.standard_normal(frames_m.shape)
    frames_m = filtered_frames(p, frames_m)
    resampled = MarkerLog(float(frames_s[0]), interval_s, frames_m).at(time_s)
    turns = [p[f"sensor.frame_{name}_rad"] for name in ("yaw", "roll", "tilt")]
    frame = Rotation.from_euler("zxy", turns)
    turned = frame.apply(resampled.reshape(-1, 3)).reshape(resampled.shape)
    return np.asarray((1.0 + p["sensor.marker_scale_share"]) * turned + shift_m)


def filtered_frames(parameters: RigParameters, frames_m: Array) -> Array:
    """Frames (n, markers, 3) of a link at rest before the first, after the software's filter.

    Choice `mocap_filter`: "none", or a Butterworth filter of second order (*Wireless Engineer* 7,
    1930 [recalled]). "low_pass": forward, as in a live stream. "zero_phase": forward and backward,
    as software filters a recording, with a response of one half at the cut-off (Winter,
    *Biomechanics and Motor Control of Human Movement* [recalled]).
    """
    p = parameters
    if p.structure.mocap_filter == "none":
        return frames_m
    from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt  # slow to import

    sections = butter(2, p["sensor.mocap_cutoff_hz"], fs=p["sensor.mocap_rate_hz"], output="sos")
    if p.structure.mocap_filter == "zero_phase":
        return np.asarray(sosfiltfilt(sections, frames_m, axis=0))
    resting = sosfilt_zi(sections)[:, :, None, None] * frames_m[:1]
    return np.asarray(sosfilt(sections, frames_m, axis=0, zi=resting)[0])
