"""Section law of the rod: wrinkling, Zener damping, logarithmic creep and Jenkins friction.

It shares the numbers of `rig.toml` with the MuJoCo link's law, not its equations. Row 0 is the root
patch, the other rows are sections of the span. Every part is a moment m against a measure of bend
u, with tau = (du/dphi)^T m, so no part can create energy:

* an elastic moment, linear up to the moment M_w at which the compressed wall wrinkles, then a
  hyperbola to the limit moment; both moments are proportional to pressure, the stiffness is the
  sum of a constant part of the wall and a part proportional to pressure;
* a Zener branch of half the stiffness that relaxes within twice the damping time, instead of a
  Kelvin-Voigt damper of the same viscosity;
* relaxing branches of equal stiffness at times that grow by a constant factor, whose creep is
  close to a logarithm of time;
* four Jenkins elements (spring and slider) in parallel, an Iwan model of hysteresis (Iwan, 1966
  [recalled]), with vector sliders for both planes.

The forms and their constants are [assumed] (docs/sources.md, "The link").
"""

from __future__ import annotations

from typing import Final

import numpy as np

from models.rig.rig_parameters import RigParameters
from models.shared.catalogue import LEAK_TIME_S, REFERENCE_BEND_RAD
from models.shared.kinematics import Array

WALL_FRACTION: Final = 0.3
"""Fraction of the bending stiffness that does not depend on pressure [assumed]."""

WRINKLE_FRACTION: Final = 0.5
"""Moment at which the wall wrinkles, relative to the limit moment: that of a tube; theory gives
2/3 for a box (docs/sources.md, "The link") [assumed]."""

ZENER_FRACTION: Final = 0.5
"""Stiffness of the damping branch, relative to the elastic one [assumed]."""

CREEP_BRANCHES: Final = 6
CREEP_REACH: Final = 3.0
"""Factor by which creep extends below the first and above the last relaxation time."""

SLIDER_FRACTIONS: Final = np.array([0.25, 0.75, 1.25, 1.75])
"""Yield bends of the sliders, relative to the yield bend; their mean is one."""


def stiffness_factor(parameters: RigParameters) -> float:
    """Stiffness of wall and pressure at the rig's pressure, relative to that at the reference."""
    p = parameters
    pressure = p["stiffness.pressure_pa"] / p["stiffness.reference_pressure_pa"]
    return WALL_FRACTION + (1.0 - WALL_FRACTION) * pressure


class SectionLaw:
    """Moments and tangent stiffness of the root patch and all sections, with their memory."""

    def __init__(self, parameters: RigParameters, step_s: float, sections: int) -> None:
        p = parameters
        pressure = p["stiffness.pressure_pa"] / p["stiffness.reference_pressure_pa"]
        self._each = np.array([1.0, *[1.0 / sections] * sections])
        span = p["stiffness.bending_n_m2"] / p["link.length_m"]
        self.stiffness_nm_rad = (
            stiffness_factor(p)
            * np.array([p["stiffness.root_nm_rad"], *[span] * sections])
            / self._each
        )
        limits = [p["stiffness.root_limit_nm"], *[p["stiffness.span_limit_nm"]] * sections]
        self._limit_nm = pressure * np.array(limits)
        self._wrinkle_nm = WRINKLE_FRACTION * self._limit_nm
        self._wrinkle_rad = self._wrinkle_nm / self.stiffness_nm_rad
        per_reference = 1.0 / (REFERENCE_BEND_RAD * self._each) ** 2
        soft = p["stiffness.softening_share"]
        self._soft = (1.0 / (1.0 - soft) ** 2 - 1.0) * per_reference
        self._hard = p["stiffness.hardening_share"] * per_reference
        self._bend_dependent = bool(self._soft.any() or self._hard.any())
        self._rest_rad = np.zeros((sections + 1, 2))
        self._rest_rad[1:, 0] = p["stiffness.prebend_rad"] / sections

        yields = [p["memory.root_yield_rad"], *[p["memory.span_yield_rad"]] * sections]
        yield_rad = (np.array(yields) * self._each)[:, None]
        self._skew = 0.5 * p["stiffness.directional_share"]
        self._rounding_rad = p["stiffness.directional_rounding"] * yield_rad
        coupling = 0.5 * p["stiffness.coupling_share"]
        self._mix = np.array([[1.0, coupling], [coupling, 1.0]])
        self._coupled = coupling != 0.0
        self._kept_fraction = 1.0 - p["stiffness.leak_share"]

        self._set_branches(p, step_s)
        self._slider_rad = SLIDER_FRACTIONS[:, None, None] * yield_rad
        self._slider_nm_rad = (
            p["memory.hysteresis_share"] / len(SLIDER_FRACTIONS) * self.stiffness_nm_rad[:, None]
        )
        self._stretch_rad = np.zeros((len(SLIDER_FRACTIONS), sections + 1, 2))
        self._attached = (
            self._branch_nm_rad.sum(axis=0)[:, 0]
            + len(SLIDER_FRACTIONS) * self._slider_nm_rad[:, 0]
        )
        self.stiffest_nm_rad = (1.0 + abs(self._skew) + abs(coupling)) ** 2 * (
            self.stiffness_nm_rad + self._attached
        )
        self._bend, _ = self._measure(np.zeros((sections + 1, 2)))

    def _set_branches(self, p: RigParameters, step_s: float) -> None:
        first, last = p["memory.relaxation_1_s"], p["memory.relaxation_3_s"]
        creep_s = np.geomspace(first / CREEP_REACH, last * CREEP_REACH, CREEP_BRANCHES)
        damping_s = p["stiffness.damping_s"] / ZENER_FRACTION
        times_s = np.array([max(damping_s, 1e-9), *creep_s])
        creep = p["memory.relaxing_share"] / CREEP_BRANCHES
        zener = ZENER_FRACTION if damping_s > 0.0 else 0.0
        fractions = np.array([zener, *[creep] * CREEP_BRANCHES])
        self._decay = np.exp(-step_s / times_s)[:, None, None]
        # Exact for a bend that grows at a constant rate over the step.
        held = times_s * -np.expm1(-step_s / times_s) / step_s
        self._branch_nm_rad = (fractions[:, None] * self.stiffness_nm_rad)[:, :, None]
        self._held_nm_rad = held[:, None, None] * self._branch_nm_rad
        self._branch_nm = np.zeros((len(times_s), len(self.stiffness_nm_rad), 2))

    def _measure(self, angle_rad: Array) -> tuple[Array, Array]:
        """Measure of bend u and the diagonal of its derivative before coupling, (n, 2) each."""
        phi = angle_rad - self._rest_rad
        if not self._skew:
            return self._mixed(phi), np.ones_like(phi)
        scaled = phi / self._rounding_rad
        size = np.abs(scaled)
        log_cosh = size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0)
        skewed = phi + self._skew * self._rounding_rad * log_cosh
        return self._mixed(skewed), 1.0 + self._skew * np.tanh(scaled)

    def _mixed(self, planes: Array) -> Array:
        """Couple both planes; shape (n, 2)."""
        return planes @ self._mix if self._coupled else planes

    def elastic_nm(self, size_rad: Array) -> tuple[Array, Array]:
        """Elastic moment and its derivative, each of shape (sections + 1,), as `size_rad`."""
        stiffness = self.stiffness_nm_rad
        room = self._limit_nm - self._wrinkle_nm
        beyond = np.maximum(size_rad - self._wrinkle_rad, 0.0)
        given = room / (room + stiffness * beyond)
        moment = stiffness * (np.minimum(size_rad, self._wrinkle_rad) + beyond * given)
        tangent = stiffness * given * given
        if self._bend_dependent:
            square = size_rad * size_rad
            soft, hard = 1.0 + self._soft * square, 1.0 + self._hard * square
            factor = hard / np.sqrt(soft)
            slope = size_rad * (2.0 * self._hard - hard * self._soft / soft) / np.sqrt(soft)
            tangent = tangent * factor + moment * slope
            moment = moment * factor
        return moment, tangent

    def advance(self, angle_rad: Array, leaking_s: float = 0.0) -> tuple[Array, Array]:
        """Advance the memory to these bends; return moments and their tangent stiffness.

        `angle_rad` (sections + 1, 2) are the bends towards +x and +y, one step after the last call.
        Moments have the shape (sections + 1, 2), the tangent stiffness (sections + 1, 2, 2); it is
        valid for bends until the next call.
        """
        u, slope = self._measure(angle_rad)
        du = u - self._bend
        self._bend = u
        branch_nm = self._branch_nm
        branch_nm *= self._decay
        branch_nm += self._held_nm_rad * du
        stretch = self._stretch_rad
        stretch += du
        length = np.sqrt(np.einsum("ijk,ijk->ij", stretch, stretch))[:, :, None]
        stretch *= np.minimum(1.0, self._slider_rad / np.maximum(length, 1e-30))

        size = np.sqrt(u[:, 0] ** 2 + u[:, 1] ** 2) + 1e-12
        elastic, along = self.elastic_nm(size)
        secant = elastic / size
        moment = secant[:, None] * u + branch_nm.sum(axis=0)
        moment += self._slider_nm_rad * stretch.sum(axis=0)
        direction = u / size[:, None]
        across = secant + self._attached
        tangent = (along - secant)[:, None, None] * direction[:, :, None] * direction[:, None, :]
        tangent[:, 0, 0] += across
        tangent[:, 1, 1] += across

        kept = self._kept_fraction ** (leaking_s / LEAK_TIME_S) if leaking_s else 1.0
        moment = kept * slope * self._mixed(moment)
        if self._coupled:
            tangent = self._mix @ tangent @ self._mix
        tangent = slope[:, :, None] * tangent * slope[:, None, :]
        return moment, kept * tangent
