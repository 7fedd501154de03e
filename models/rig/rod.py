"""Link as a Cosserat rod on PyElastica: its law, its geometry, its base joints and its engine.

It shares the numbers of `rig.toml` with the hinged link, not its equations.
"""

from __future__ import annotations

from math import cos, sin
from typing import Final

import numpy as np
from elastica.rod.cosserat_rod import CosseratRod
from elastica.rod.data_structures import overload_operator_kinematic_numba

from firmware_py.core.errors import InputError
from models.rig.parameters import DEFAULT_STRUCTURE, RigParameters, link_stiffness
from models.rig.rig import Load, Rig
from models.shared.catalogue import LEAK_TIME_S, REFERENCE_BEND_RAD
from models.shared.kinematics import Array

ZENER_FRACTION: Final = 0.5
"""Stiffness of the damping branch, relative to the elastic one [assumed]."""

CREEP_BRANCHES: Final = 6
CREEP_REACH: Final = 3.0
"""Factor by which creep extends below the first and above the last relaxation time."""

SLIDER_FRACTIONS: Final = np.array([0.25, 0.75, 1.25, 1.75])
"""Yield bends of the sliders, relative to the yield bend; their mean is one."""


def size_of(planes: Array) -> Array:
    """Length of the vector of each section, shape (n,)."""
    return np.sqrt(planes[:, 0] ** 2 + planes[:, 1] ** 2)


class SectionLaw:
    """Moments and tangent stiffness of the root patch and all sections, with their memory.

    Row 0 is the root patch, the other rows are sections of the span. The moment M of the fabric is
    the sum, against a measure of bend u, with tau = (du/dphi)^T m, of

    * an elastic moment;
    * a Zener branch of half the stiffness that relaxes within twice the damping time, instead of a
      Kelvin-Voigt damper of the same viscosity;
    * relaxing branches of equal stiffness at times that grow by a constant factor, whose creep is
      close to a logarithm of time;
    * four Jenkins elements (spring and slider) in parallel, an Iwan model of hysteresis (*J.
      Applied Mechanics* 33, 1966 [recalled]), with vector sliders for both planes.

    Pressure bounds all of it radially (`models.rig.hinged.BendLaw` says why, and what is known of
    its passivity): m = M up to half of the limit moment M_c, where the compressed wall wrinkles,
    then a hyperbola to the limit, M_c (1 - M_c / (4 |M|)). Half is the onset of a tube; theory
    gives 2/3 for a box. The forms and constants are [assumed] (docs/sources.md, "The link").
    """

    def __init__(self, parameters: RigParameters, step_s: float, sections: int) -> None:
        p = parameters
        link = link_stiffness(p)
        self._each = np.array([1.0, *[1.0 / sections] * sections])
        span = link.bending_n_m2 / p["link.length_m"]
        self.stiffness_nm_rad = np.array([link.root_nm_rad, *[span] * sections]) / self._each
        self._limit_nm = np.array([link.root_limit_nm, *[link.span_limit_nm] * sections])
        per_reference = 1.0 / (REFERENCE_BEND_RAD * self._each) ** 2
        soft = p["stiffness.softening_share"]
        self._soft = (1.0 / (1.0 - soft) ** 2 - 1.0) * per_reference
        self._hard = p["stiffness.hardening_share"] * per_reference
        self._rest_rad = np.zeros((sections + 1, 2))
        self._rest_rad[1:, 0] = p["stiffness.prebend_rad"] / sections

        yields = [p["memory.root_yield_rad"], *[p["memory.span_yield_rad"]] * sections]
        yield_rad = (np.array(yields) * self._each)[:, None]
        self._skew = 0.5 * p["stiffness.directional_share"]
        self._rounding_rad = p["stiffness.directional_rounding"] * yield_rad
        coupling = 0.5 * p["stiffness.coupling_share"]
        self._mix = np.array([[1.0, coupling], [coupling, 1.0]])
        self._remaining_share = 1.0 - p["stiffness.leak_share"]

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
        # Hardening is steepest below the onset of wrinkling, where the bend is M_c / (2 K) or less.
        hardest = np.linspace(0.0, 0.5 * self._limit_nm / self.stiffness_nm_rad, 200)
        moments, slopes = self._elastic_nm(hardest)
        steepest = np.max(np.where(moments <= 0.5 * self._limit_nm, slopes, 0.0), axis=0)
        self.stiffest_nm_rad = (1.0 + abs(self._skew) + abs(coupling)) ** 2 * (
            np.maximum(steepest, self.stiffness_nm_rad) + self._attached
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
        gain = times_s * -np.expm1(-step_s / times_s) / step_s
        self._branch_nm_rad = (fractions[:, None] * self.stiffness_nm_rad)[:, :, None]
        self._gained_nm_rad = gain[:, None, None] * self._branch_nm_rad
        self._branch_nm = np.zeros((len(times_s), len(self.stiffness_nm_rad), 2))

    def _measure(self, angle_rad: Array) -> tuple[Array, Array]:
        """Measure of bend u and the diagonal of its derivative before coupling, (n, 2) each."""
        phi = angle_rad - self._rest_rad
        scaled = phi / self._rounding_rad
        size = np.abs(scaled)
        log_cosh = size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0)
        skewed = phi + self._skew * self._rounding_rad * log_cosh
        return skewed @ self._mix, 1.0 + self._skew * np.tanh(scaled)

    def _elastic_nm(self, size_rad: Array) -> tuple[Array, Array]:
        """Elastic moment without limit and its derivative, each of shape (sections + 1,)."""
        stiffness = self.stiffness_nm_rad
        square = size_rad * size_rad
        soft, hard = 1.0 + self._soft * square, 1.0 + self._hard * square
        factor = hard / np.sqrt(soft)
        slope = size_rad * (2.0 * self._hard - hard * self._soft / soft) / np.sqrt(soft)
        return stiffness * size_rad * factor, stiffness * (factor + size_rad * slope)

    def _limited(self, moment_nm: Array, tangent: Array) -> tuple[Array, Array]:
        """Whole moment (n, 2) and its tangent stiffness (n, 2, 2), bounded by the limit moment.

        The derivative of the limit is A = f' along the moment and f/x across. The tangent stiffness
        is sqrt(A) T sqrt(A), which is symmetric, positive, and A T where the moment is along the
        bend.
        """
        size_nm = size_of(moment_nm)
        level = np.maximum(size_nm / self._limit_nm, 0.5)
        across = (1.0 - 0.25 / level) / level
        along = 0.25 / (level * level)
        direction = moment_nm / (size_nm + 1e-12)[:, None]
        root = np.sqrt(across)[:, None, None] * np.eye(2)
        root = root + (np.sqrt(along) - np.sqrt(across))[:, None, None] * (
            direction[:, :, None] * direction[:, None, :]
        )
        return across[:, None] * moment_nm, root @ tangent @ root

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
        branch_nm += self._gained_nm_rad * du
        stretch = self._stretch_rad
        stretch += du
        length = np.sqrt(np.einsum("ijk,ijk->ij", stretch, stretch))[:, :, None]
        stretch *= np.minimum(1.0, self._slider_rad / np.maximum(length, 1e-30))

        size = size_of(u) + 1e-12
        elastic, along = self._elastic_nm(size)
        secant = elastic / size
        moment = secant[:, None] * u + branch_nm.sum(axis=0)
        moment += self._slider_nm_rad * stretch.sum(axis=0)
        direction = u / size[:, None]
        across = secant + self._attached
        tangent = (along - secant)[:, None, None] * direction[:, :, None] * direction[:, None, :]
        tangent[:, 0, 0] += across
        tangent[:, 1, 1] += across
        moment, tangent = self._limited(moment, tangent)

        remaining = self._remaining_share ** (leaking_s / LEAK_TIME_S) if leaking_s else 1.0
        moment = remaining * slope * (moment @ self._mix)
        tangent = slope[:, :, None] * (self._mix @ tangent @ self._mix) * slope[:, None, :]
        return moment, remaining * tangent


ROOT_TWIST_NM_RAD: Final = 200.0
"""Torsional stiffness of the root patch [assumed]; the MuJoCo link does not twist."""

SMOOTHING_S: Final = 2e-4
"""Kelvin-Voigt time of bending that damps the fastest rotations of elements, which the law, updated
once per step, would excite [numerical]; it damps the first mode by less than 0.2 %."""

COURANT: Final = 1.8
"""Highest rate of the rod times its time step; the position Verlet method is stable below 2."""


class RodLink:
    """Cosserat rod on a plate whose pose and velocity are prescribed: inertia, law, markers.

    The rod lies along +z. Its first element is a stub inside the plate, which the base joints move;
    the root patch is the joint between the stub and the link. The elements of the link are as long
    as a section, the first and the last one half as long, so sections are in the middle of equal
    parts. PyElastica computes internal forces and moments from strains. All that is not elastic
    enters as rest strains and tangent stiffness, updated in every step of the rig.
    """

    def __init__(self, parameters: RigParameters, load: Load, sections: int) -> None:
        p = parameters
        length, piece = p["link.length_m"], p["link.length_m"] / sections
        self._sections, self._layout = sections, p.layout
        self._row_places = [
            _element_of(h / length * sections + 0.5, sections) for h in p.layout.rows_m
        ]
        self.law = SectionLaw(p, p["world.step_s"], sections)
        lengths = np.array([0.5 * piece, 0.5 * piece, *[piece] * (sections - 1), 0.5 * piece])
        heights = p["link.base_offset_m"] - lengths[0] + np.concatenate([[0.0], np.cumsum(lengths)])
        position = np.zeros((3, len(heights)))
        position[2] = heights
        self.rod = CosseratRod.straight_rod(
            len(lengths), position[:, 0].copy(), np.array([0.0, 0.0, 1.0]),
            np.array([1.0, 0.0, 0.0]), float(length + lengths[0]), 0.5 * p["link.width_m"], 1.0,
            youngs_modulus=1.0, position=position,
        )  # fmt: skip
        self._set_mass(p, lengths, load)
        self._set_stiffness(p, lengths)
        self._weight_n = load.gravity_m_s2[:, None] * self.rod.mass
        self._weight_n[:, :2] = 0.0  # these nodes are on the plate
        self._drag = p["world.drag_nm"] * self._link_kg / np.sum(self._link_kg * heights**3)
        self._keep_pose()

    def _set_mass(self, p: RigParameters, lengths: Array, load: Load) -> None:
        rod, width = self.rod, p["link.width_m"]
        element_kg = p["link.mass_kg"] / p["link.length_m"] * lengths
        element_kg[0] = 0.0  # the stub is part of the plate
        self._link_kg = 0.5 * (np.append(element_kg, 0.0) + np.insert(element_kg, 0, 0.0))
        self.root_mass_kg = float(self._link_kg[1])
        rod.mass[:] = self._link_kg
        rod.mass[:2] = 1e9  # moved by the plate, not by forces
        inertia = rod.mass_second_moment_of_inertia
        inertia[:] = 0.0
        for axis, share in enumerate((1.0 / 12.0, 1.0 / 12.0, 1.0 / 6.0)):
            inertia[axis, axis] = share * width**2 * element_kg
        tip_kg = p["link.tip_mass_kg"] + p["link.extra_tip_mass_kg"]
        rod.mass[-1] += tip_kg + load.payload_kg
        inertia[:, :, -1] += np.eye(3) * (
            tip_kg * width**2 / 12.0 + load.payload_kg * p["link.payload_size_m"] ** 2 / 6.0
        )
        # The payload is fixed to the last element at an offset. Eliminating the acceleration of the
        # node leaves the payload's reduced mass in the element's inertia.
        offset = np.array([load.offset_x_m, load.offset_y_m, 0.0])
        self._payload_share = load.payload_kg / rod.mass[-1]
        reduced_kg = load.payload_kg * (1.0 - self._payload_share)
        inertia[:, :, -1] += reduced_kg * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        self._offset_m = (load.offset_x_m, load.offset_y_m)
        inverse = rod.inv_mass_second_moment_of_inertia
        inverse[:] = 0.0
        inverse[:, :, 1:] = np.linalg.inv(np.moveaxis(inertia[:, :, 1:], 2, 0)).transpose(1, 2, 0)

    def _set_stiffness(self, p: RigParameters, lengths: Array) -> None:
        """Set shear, stretch and twist, linear with a Zener branch; set the number of substeps."""
        rod, law, width = self.rod, self.law, p["link.width_m"]
        link, step_s = link_stiffness(p), p["world.step_s"]
        # Et of the walls from E I = Et 2/3 h^3, Gt from the wall's shear 5/6 2 h Gt; four walls
        # stretch, and twist by Bredt's formula.
        wall_n_m = link.bending_n_m2 * 1.5 / width**3
        twist_n_m2 = p["stiffness.wall_shear_n"] / (5.0 / 3.0 * width) * width**3
        damping_s = p["stiffness.damping_s"] / ZENER_FRACTION
        whole = 1.0 + (ZENER_FRACTION if damping_s > 0.0 else 0.0)
        self._zener = 1.0 - 1.0 / whole
        self._relaxed = -np.expm1(-step_s / max(damping_s, 1e-9))
        rod.shear_matrix[:] = 0.0
        for axis, force_n in enumerate((link.shear_n, link.shear_n, 4.0 * width * wall_n_m)):
            rod.shear_matrix[axis, axis] = whole * force_n
        self._voronoi_m = rod.rest_voronoi_lengths
        rod.bend_matrix[:] = 0.0
        twist = twist_n_m2 * self._sections / p["link.length_m"]
        twist_nm_rad = np.array([ROOT_TWIST_NM_RAD, *[twist] * self._sections])
        rod.bend_matrix[2, 2] = whole * twist_nm_rad * self._voronoi_m
        self._sigma_creep = np.zeros_like(rod.sigma)
        self._twist_creep = np.zeros(self._sections + 1)

        self._set_smoothing(step_s)
        across = np.diagonal(rod.inv_mass_second_moment_of_inertia, axis1=0, axis2=1)[1:].max(1)
        bend = law.stiffest_nm_rad
        stiffness = np.diag(bend + np.append(bend[1:], 0.0) + whole * link.shear_n * lengths[1:])
        stiffness -= np.diag(bend[1:], 1) + np.diag(bend[1:], -1)
        rate = np.linalg.eigvalsh(stiffness * np.sqrt(np.outer(across, across))).max()
        stretch = 4.0 * rod.shear_matrix[2, 2, 1] / lengths[1] / rod.mass[2:].min()
        fastest_rad_s = np.sqrt(max(rate, stretch))
        self.substeps = max(int(np.ceil(step_s * fastest_rad_s / COURANT)), 1)

    def _set_smoothing(self, step_s: float) -> None:
        """Set the implicit step of viscous moments between adjacent elements, about both axes."""
        damping = step_s * SMOOTHING_S * self.law.stiffness_nm_rad
        matrix = np.diag(damping + np.append(damping[1:], 0.0))
        matrix -= np.diag(damping[1:], 1) + np.diag(damping[1:], -1)
        inertia = np.diagonal(self.rod.mass_second_moment_of_inertia, axis1=0, axis2=1)[1:, :2]
        self._smooth = np.array([np.linalg.inv(matrix + np.diag(i)) * i for i in inertia.T])
        self._carried = 1.0 - self._smooth.sum(axis=2)

    @property
    def bend_rad(self) -> Array:
        """Bend of root patch and sections towards +x and +y, shape (sections + 1, 2)."""
        kappa = self.rod.kappa
        bend = np.stack([kappa[1], -kappa[0]], axis=1) * self._voronoi_m[:, None]
        return np.asarray(bend)

    @property
    def markers_m(self) -> Array:
        """Markers in the world frame, shape (markers, 3), at the start of the last step."""
        position, director = self._pose
        corners = np.array(self._layout.corners_m)
        rows = [
            (1 - place) * position[:, element] + place * position[:, element + 1]
            + corners @ director[:2, :, element]
            for element, place in self._row_places
        ]  # fmt: skip
        return np.concatenate(rows)

    def _keep_pose(self) -> None:
        self._pose = self.rod.position_collection.copy(), self.rod.director_collection.copy()

    def begin_step(self, plate_rad_s: Array, leaking_s: float) -> None:
        """Update the law, the drag and the markers at the start of a step of the rig.

        `plate_rad_s` (2, 1) is the rate of the plate about its axes x and y.
        """
        rod = self.rod
        self._keep_pose()
        bend = self.bend_rad
        moment, tangent = self.law.advance(bend, leaking_s)
        xx, yy, xy = tangent[:, 0, 0], tangent[:, 1, 1], tangent[:, 0, 1]
        scale = 1.0 / (xx * yy - xy * xy)
        rest_x = bend[:, 0] - scale * (yy * moment[:, 0] - xy * moment[:, 1])
        rest_y = bend[:, 1] - scale * (xx * moment[:, 1] - xy * moment[:, 0])
        length = self._voronoi_m
        # A bend towards +x turns about +y, one towards +y about -x.
        rod.bend_matrix[1, 1], rod.bend_matrix[0, 0] = xx * length, yy * length
        rod.bend_matrix[0, 1] = rod.bend_matrix[1, 0] = -xy * length
        rod.rest_kappa[1], rod.rest_kappa[0] = rest_x / length, -rest_y / length
        self._twist_creep += self._relaxed * (rod.kappa[2] - self._twist_creep)
        self._sigma_creep += self._relaxed * (rod.sigma - self._sigma_creep)
        rod.rest_kappa[2] = self._zener * self._twist_creep
        rod.rest_sigma[:] = self._zener * self._sigma_creep
        omega = rod.omega_collection
        turning = np.einsum("ijk,ik->ij", self._smooth, omega[:2, 1:])
        omega[:2, 1:] = turning + self._carried * plate_rad_s
        velocity = rod.velocity_collection
        speed = np.sqrt(np.einsum("ij,ij->j", velocity, velocity))
        rod.external_forces[:] = self._weight_n - self._drag * speed * velocity

    def move(self, step_s: float) -> None:
        """Advance nodes and elements with their velocities by a time."""
        rod = self.rod
        overload_operator_kinematic_numba(
            step_s, rod.position_collection, rod.director_collection,
            rod.velocity_collection, rod.omega_collection,
        )  # fmt: skip

    def accelerate(self, step_s: float) -> None:
        """Compute forces and moments and advance the velocities by a time.

        The payload is fixed to the last element, beside the axis. With node force F, offset r, and
        payload m out of the node's mass M, in the element's frame: the moment gains
        -(m / M) r x F, and the node the acceleration -(m / M) (alpha x r + omega x (omega x r)).
        F does not include weight.
        """
        rod, share = self.rod, self._payload_share
        rod.compute_internal_forces_and_torques(0.0)
        x, y = self._offset_m
        turn = rod.director_collection[:, :, -1]
        fx, fy, fz = (turn @ rod.internal_forces[:, -1]).tolist()
        rod.external_torques[:, -1] = (-share * y * fz, share * x * fz, share * (y * fx - x * fy))
        rod.update_accelerations(0.0, 0.0)
        ax, ay, az = rod.alpha_collection[:, -1].tolist()
        wx, wy, wz = rod.omega_collection[:, -1].tolist()
        along, square = wx * x + wy * y, wx * wx + wy * wy + wz * wz
        arm = (
            -az * y + wx * along - square * x, az * x + wy * along - square * y,
            ax * y - ay * x + wz * along,
        )  # fmt: skip
        rod.acceleration_collection[:, -1] -= share * (np.array(arm) @ turn)
        rod.velocity_collection += step_s * rod.acceleration_collection
        rod.omega_collection += step_s * rod.alpha_collection


def _element_of(at: float, sections: int) -> tuple[int, float]:
    """Element of a height on the link, and the place in it from 0 to 1.

    `at` is the height in pieces, and a half: elements join in mid-piece. The first element after
    the stub and the last one are half as long.
    """
    piece = min(int(at), sections)
    place = at - piece
    if piece == 0:
        place = 2.0 * (place - 0.5)
    elif piece == sections:
        place = 2.0 * place
    return piece + 1, place


class BaseJoints:
    """Yoke and plate on one or two driven joints, with the rod's reaction; they move its stub.

    Joint 1 turns about y, joint 2 about -x and moves with joint 1. Yoke and plate have equal
    inertia about all axes; the plate's mass and the rod's first node are at one point above the
    axes, so

        M_1 = 2 I + m h^2 cos(q_2)^2,   M_2 = I + m h^2

    with centrifugal terms from Lagrange's equations and no coupling in the mass matrix.
    """

    def __init__(self, parameters: RigParameters, link: RodLink, load: Load) -> None:
        p = parameters
        self._rod = rod = link.rod
        self._height_m = p["link.base_offset_m"]
        self._heights_m = rod.position_collection[2, :2].copy()
        self._turn = 1.0, 0.0, 1.0, 0.0
        mass_kg = p["link.plate_mass_kg"] + link.root_mass_kg
        self._weight_n: list[float] = (mass_kg * load.gravity_m_s2).tolist()
        self._frame = p["link.frame_inertia_kg_m2"]
        self._point = mass_kg * self._height_m**2
        self.angle_rad, self.rate_rad_s = [0.0, 0.0], [0.0, 0.0]

    def move(self, step_s: float) -> None:
        """Advance the joint angles with their rates by a time."""
        self.angle_rad[0] += step_s * self.rate_rad_s[0]
        self.angle_rad[1] += step_s * self.rate_rad_s[1]

    def place_stub(self) -> None:
        """Set the pose of the rod's first element and its nodes."""
        rod = self._rod
        q1, q2 = self.angle_rad
        c1, s1, c2, s2 = self._turn = cos(q1), sin(q1), cos(q2), sin(q2)
        pose = np.array((c1, 0.0, -s1, -s1 * s2, c2, -c1 * s2, s1 * c2, s2, c1 * c2)).reshape(3, 3)
        rod.director_collection[:, :, 0] = pose
        rod.position_collection[:, :2] = pose[2, :, None] * self._heights_m

    @property
    def plate_rad_s(self) -> Array:
        """Rate of the plate about its axes x and y, shape (2, 1)."""
        return np.array([[-self.rate_rad_s[1]], [self.rate_rad_s[0] * self._turn[2]]])

    def place_stub_velocity(self) -> None:
        """Set the velocity of the rod's first nodes, which drag and stretch rate depend on."""
        (c1, s1, c2, s2), (w1, w2), height = self._turn, self.rate_rad_s, self._height_m
        along, up = height * w1 * c2, -height * w2 * s2
        self._rod.velocity_collection[:, :2] = np.array(
            [[c1 * along + s1 * up], [height * w2 * c2], [c1 * up - s1 * along]]
        )

    def accelerate(self, torque_nm: list[float], step_s: float) -> None:
        """Advance the rates by a time, with servo torques, weight and the rod's reaction."""
        rod, height, point = self._rod, self._height_m, self._point
        w1, w2 = self.rate_rad_s
        c1, s1, c2, s2 = self._turn
        reaction_n = rod.internal_forces[:, 1].tolist()
        fx, fy, fz = (r + w for r, w in zip(reaction_n, self._weight_n, strict=True))
        mx, my, mz = rod.internal_torques[:, 0].tolist()
        # The force in the frame of the plate acts on an arm along its axis.
        mx -= height * (-s1 * s2 * fx + c2 * fy - c1 * s2 * fz)
        my += height * (c1 * fx - s1 * fz)
        turn1 = torque_nm[0] + c2 * my + s2 * mz + 2.0 * point * c2 * s2 * w1 * w2
        self.rate_rad_s[0] = w1 + step_s * turn1 / (2.0 * self._frame + point * c2 * c2)
        if len(torque_nm) > 1:
            turn2 = torque_nm[1] - mx - point * c2 * s2 * w1 * w1
            self.rate_rad_s[1] = w2 + step_s * turn2 / (self._frame + point)


SECTIONS: Final = 8
"""Sections of the span; halving their length shifts the first mode by less than 1 %."""

HINGED_CHOICES: Final = ("hinges", "limit", "hysteresis", "creep")
"""Choices of a structure that apply to the MuJoCo link only; the rod has other forms."""


class CosseratRig(Rig):
    """`Rig` on PyElastica.

    Rod, joints and servos advance by the position Verlet method, in substeps that are stable for
    the stiffest section. Section law, drag and leak are updated once per step.
    """

    def __init__(
        self, parameters: RigParameters, dof: int, load: Load, sections: int = SECTIONS
    ) -> None:
        p = parameters
        for choice in HINGED_CHOICES:
            chosen = getattr(p.structure, choice)
            if chosen != getattr(DEFAULT_STRUCTURE, choice):
                raise InputError(
                    p.path, f"chooses {choice} = {chosen!r}, which is not the rod's", "leave it out"
                )
        self.link = RodLink(p, load, sections)
        self.joints = BaseJoints(p, self.link, load)
        self._substep_s = p["world.step_s"] / self.link.substeps
        super().__init__(p, dof, self._substep_s)

    @property
    def joint_rad(self) -> list[float]:
        return self.joints.angle_rad[: len(self.servos)]

    @property
    def link_markers_m(self) -> Array:
        return self.link.markers_m

    @property
    def largest_bend_rad(self) -> float:
        return float(np.max(np.abs(self.link.bend_rad)))

    def advance(self) -> None:
        link, joints, servos = self.link, self.joints, self.servos
        start_s, part_s, substeps = self.time_s, self._substep_s, link.substeps
        link.begin_step(joints.plate_rad_s, self.leaking_s)
        link.move(0.5 * part_s)
        joints.move(0.5 * part_s)
        for k in range(substeps):
            time_s = start_s + k * part_s
            torque_nm = [
                servo.step(time_s, angle, rate) + servo.load_nm
                for servo, angle, rate in zip(
                    servos, joints.angle_rad, joints.rate_rad_s, strict=False
                )
            ]
            joints.place_stub()
            link.accelerate(part_s)
            joints.accelerate(torque_nm, part_s)
            onward_s = part_s if k < substeps - 1 else 0.5 * part_s
            link.move(onward_s)
            joints.move(onward_s)
        joints.place_stub()
        joints.place_stub_velocity()
