"""Cosserat rod of the link (PyElastica): geometry, inertia, tip, section law and markers.

The rod lies along +z. Its first element is a stub inside the plate, which the base joints move; the
root patch is the joint between the stub and the link. The elements of the link are as long as a
section, the first and the last one half as long, so sections are in the middle of equal parts.
PyElastica computes internal forces and moments from strains. All that is not elastic enters as rest
strains and tangent stiffness, updated in every step of the rig.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from elastica.rod.cosserat_rod import CosseratRod
from elastica.rod.data_structures import overload_operator_kinematic_numba

from models.rig.cosserat.section_law import ZENER_FRACTION, SectionLaw, stiffness_factor
from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array

ROOT_TWIST_NM_RAD: Final = 200.0
"""Torsional stiffness of the root patch [assumed]; the MuJoCo link does not twist."""

SMOOTHING_S: Final = 2e-4
"""Kelvin-Voigt time of bending that damps the fastest rotations of elements, which the law, updated
once per step, would excite [numerical]; it damps the first mode by less than 0.2 %."""

COURANT: Final = 1.8
"""Highest rate of the rod times its time step; the position Verlet method is stable below 2."""


MOST_SPLITS: Final = 20
"""Most splits of a substep; above, the link is about to fold or its state is not finite."""


@dataclass(frozen=True)
class TipLoad:
    """Payload at the tip: its mass and the offset of its centre from the link's axis."""

    mass_kg: float = 0.0
    offset_x_m: float = 0.0
    offset_y_m: float = 0.0


class RodLink:
    """Link on a plate whose pose and velocity are prescribed."""

    def __init__(
        self, parameters: RigParameters, load: TipLoad, gravity_m_s2: Array, sections: int
    ) -> None:
        p = parameters
        length, piece = p["link.length_m"], p["link.length_m"] / sections
        self._sections, self._half_m = sections, 0.5 * p["link.width_m"]
        self._layout = p.layout
        # Element of each row, and the place in it from 0 to 1; elements join in mid-piece.
        places = [h / length * sections + 0.5 for h in p.layout.rows_m]
        self._row_places = [(min(int(at), sections), at - min(int(at), sections)) for at in places]
        self.law = SectionLaw(p, p["world.step_s"], sections)
        lengths = np.array([0.5 * piece, 0.5 * piece, *[piece] * (sections - 1), 0.5 * piece])
        heights = p["link.base_offset_m"] - lengths[0] + np.concatenate([[0.0], np.cumsum(lengths)])
        position = np.zeros((3, len(heights)))
        position[2] = heights
        self.rod = CosseratRod.straight_rod(
            len(lengths), position[:, 0].copy(), np.array([0.0, 0.0, 1.0]),
            np.array([1.0, 0.0, 0.0]), float(length + lengths[0]), self._half_m, 1.0,
            youngs_modulus=1.0, position=position,
        )  # fmt: skip
        self._set_mass(p, lengths, load)
        self._set_stiffness(p, lengths)
        self._weight_n = gravity_m_s2[:, None] * self.rod.mass
        self._weight_n[:, :2] = 0.0  # these nodes are on the plate
        self._drag = p["world.drag_nm"] * self._link_kg / np.sum(self._link_kg * heights**3)
        self.splits = 1
        self._keep_pose()

    def _set_mass(self, p: RigParameters, lengths: Array, load: TipLoad) -> None:
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
        rod.mass[-1] += tip_kg + load.mass_kg
        inertia[:, :, -1] += np.eye(3) * (
            tip_kg * width**2 / 12.0 + load.mass_kg * p["link.payload_size_m"] ** 2 / 6.0
        )
        # The payload is fixed to the last element at an offset. Eliminating the acceleration of the
        # node leaves the payload's reduced mass in the element's inertia.
        offset = np.array([load.offset_x_m, load.offset_y_m, 0.0])
        self._payload_share = load.mass_kg / rod.mass[-1]
        reduced_kg = load.mass_kg * (1.0 - self._payload_share)
        inertia[:, :, -1] += reduced_kg * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        self._offset_m = (load.offset_x_m, load.offset_y_m)
        self._eccentric = bool(load.mass_kg > 0.0 and offset.any())
        inverse = rod.inv_mass_second_moment_of_inertia
        inverse[:] = 0.0
        inverse[:, :, 1:] = np.linalg.inv(np.moveaxis(inertia[:, :, 1:], 2, 0)).transpose(1, 2, 0)

    def _set_stiffness(self, p: RigParameters, lengths: Array) -> None:
        """Set shear, stretch and twist, linear with a Zener branch; set the number of substeps."""
        rod, law, width = self.rod, self.law, p["link.width_m"]
        factor, step_s = stiffness_factor(p), p["world.step_s"]
        # Et of the walls from E I = Et 2/3 h^3, Gt from the wall's shear 5/6 2 h Gt; four walls
        # stretch, and twist by Bredt's formula.
        wall_n_m = factor * p["stiffness.bending_n_m2"] * 1.5 / width**3
        twist_n_m2 = p["stiffness.wall_shear_n"] / (5.0 / 3.0 * width) * width**3
        shear_n = p["stiffness.wall_shear_n"] + p["stiffness.pressure_pa"] * width**2
        damping_s = p["stiffness.damping_s"] / ZENER_FRACTION
        whole = 1.0 + (ZENER_FRACTION if damping_s > 0.0 else 0.0)
        self._zener = 1.0 - 1.0 / whole
        self._relaxed = -np.expm1(-step_s / max(damping_s, 1e-9))
        rod.shear_matrix[:] = 0.0
        for axis, force_n in enumerate((shear_n, shear_n, 4.0 * width * wall_n_m)):
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
        stiffness = np.diag(bend + np.append(bend[1:], 0.0) + whole * shear_n * lengths[1:])
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
        markers = np.empty((self._layout.rows, self._layout.corners, 3))
        corners = np.array(self._layout.corners_m)
        last = self._layout.rows - 1
        for row, (piece, fraction) in enumerate(self._row_places):
            element = piece + 1
            if row == last:
                centre = position[:, -1]
            elif piece == 0:  # the first element is half as long, from the plate on
                along = 2.0 * (fraction - 0.5)
                centre = (1 - along) * position[:, 1] + along * position[:, 2]
            else:
                centre = (1 - fraction) * position[:, element] + fraction * position[:, element + 1]
            markers[row] = centre + corners @ director[:2, :, element]
        return markers.reshape(-1, 3)

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
        excess = np.max(np.maximum(xx, yy) / self.law.stiffest_nm_rad)
        self.splits = int(np.ceil(np.sqrt(excess))) if 1.0 < excess < MOST_SPLITS**2 else 1
        scale = 1.0 / (xx * yy - xy * xy)
        rest_x = bend[:, 0] - scale * (yy * moment[:, 0] - xy * moment[:, 1])
        rest_y = bend[:, 1] - scale * (xx * moment[:, 1] - xy * moment[:, 0])
        length = self._voronoi_m
        # A bend towards +x turns about +y, one towards +y about -x.
        rod.bend_matrix[1, 1], rod.bend_matrix[0, 0] = xx * length, yy * length
        rod.bend_matrix[0, 1] = rod.bend_matrix[1, 0] = -xy * length
        rod.rest_kappa[1], rod.rest_kappa[0] = rest_x / length, -rest_y / length
        if self._zener:
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
        """Compute forces and moments and advance the velocities by a time."""
        rod = self.rod
        rod.compute_internal_forces_and_torques(0.0)
        if self._eccentric:
            self._accelerate_eccentric()
        else:
            rod.update_accelerations(0.0, step_s)
        rod.velocity_collection += step_s * rod.acceleration_collection
        rod.omega_collection += step_s * rod.alpha_collection

    def _accelerate_eccentric(self) -> None:
        """Accelerations with a payload beside the axis, fixed to the last element.

        With node force F, offset r, and payload m out of the node's mass M, in the element's frame:
        the moment gains -(m / M) r x F, and the node the acceleration
        -(m / M) (alpha x r + omega x (omega x r)). F does not include weight.
        """
        rod, share = self.rod, self._payload_share
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
