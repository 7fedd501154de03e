"""Spectrum of the link's relaxation: three branches, or a power law of time.

A power law is that of a fractional element, whose spectrum of relaxation times falls as tau^-alpha
per decade (Mainardi, *Fractional Calculus and Waves in Linear Viscoelasticity*, 2010 [recalled]);
it has one branch per half decade here. Both spectra sum up to the relaxing fraction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array


class RelaxationSpectrum(NamedTuple):
    """Maxwell branches: times in s and fractions of the stiffness, shape (n,) each."""

    times_s: Array
    fractions: Array


def relaxation_spectrum(parameters: RigParameters) -> RelaxationSpectrum:
    """Build the spectrum that the structure names."""
    p = parameters
    relaxing = p["memory.relaxing_share"]
    if p.structure.creep == "branches":
        times_s = np.array([p[f"memory.relaxation_{b}_s"] for b in (1, 2, 3)])
        return RelaxationSpectrum(times_s, np.full(len(times_s), relaxing / len(times_s)))
    shortest_s, longest_s = p["memory.power_shortest_s"], p["memory.power_longest_s"]
    count = 1 + round(2.0 * np.log10(longest_s / shortest_s))
    times_s = np.geomspace(shortest_s, longest_s, count)
    weights = times_s ** -p["memory.power_exponent"]
    return RelaxationSpectrum(times_s, relaxing * weights / weights.sum())
