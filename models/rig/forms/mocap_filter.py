"""Filter of the motion capture's software over its frames: none, causal, or zero-phase.

Butterworth filters of second order (Butterworth, *Wireless Engineer* 7, 1930 [recalled]): forward
once, as in a live stream, or forward and backward, as software filters a recording (Winter,
*Biomechanics and Motor Control of Human Movement* [recalled]), with a response of one half at the
cut-off.
"""

from __future__ import annotations

import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array


def filtered_frames(parameters: RigParameters, frames_m: Array) -> Array:
    """Frames after the software's filter, shape (n, markers, 3), at the motion capture's rate.

    The link is at rest before the first frame.
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
