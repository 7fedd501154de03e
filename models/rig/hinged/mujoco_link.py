"""MuJoCo model of the robot: base joints, plate, link of hinge and shear pairs, tip, markers.

There is one hinge pair at the root patch and one in the middle of each of the equal pieces of the
span, eight by default. Every hinge pair of the span has a shear pair (two slides). MuJoCo computes
inertia, gravity, the linear shear springs and the Kelvin-Voigt damping; the bending torque is that
of `models.rig.hinged.bending_law`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from firmware_py.link.marker_layout import MarkerLayout
from models.rig.rig_parameters import RigParameters
from models.shared.kinematics import Array

AXES: Final = {"x": (0.0, 1.0, 0.0), "y": (-1.0, 0.0, 0.0)}
"""Axis about which a positive angle moves the tip towards +x and +y."""


@dataclass(frozen=True)
class Load:
    """Payload at the tip: its mass and the offset of its centre from the link's axis."""

    mass_kg: float = 0.0
    offset_x_m: float = 0.0
    offset_y_m: float = 0.0


@dataclass(frozen=True)
class MujocoLink:
    """Compiled model and the addresses of its joints and bodies."""

    model: Any  # Only hinges and slides, so positions and rates have the same addresses
    joints: NDArray[np.intp]  # Addresses of the driven joints, (dof,)
    # Addresses of the link's hinges, (n, 2), root first; the columns bend towards +x and +y
    hinges: NDArray[np.intp]
    bodies: NDArray[np.intp]  # Ids of the link's pieces, (n,)


def build_mujoco_link(
    parameters: RigParameters, dof: int, load: Load, gravity_m_s2: Array, stiffness_nm_rad: Array
) -> MujocoLink:
    """Build the model; with one driven joint, the second is rigid.

    `stiffness_nm_rad` (n,) is that of the hinge pairs; the damping is proportional to it.
    """
    p = parameters
    spec = mujoco.MjSpec()
    spec.option.timestep = p["world.step_s"]
    spec.option.gravity = gravity_m_s2
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = int(
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    )
    frame = [p["link.frame_inertia_kg_m2"]] * 3
    yoke = _body(spec.worldbody, "yoke", 0.0, p["link.yoke_mass_kg"], frame)
    _joint(yoke, "joint_x", "x")
    plate = _body(yoke, "plate", 0.0, 0.0, [0.0] * 3)
    if dof == 2:
        _joint(plate, "joint_y", "y")
    _body(plate, "base", p["link.base_offset_m"], p["link.plate_mass_kg"], frame)
    _add_link(plate, p, stiffness_nm_rad, load)
    model, pairs = spec.compile(), p.structure.hinges + 1
    return MujocoLink(
        model=model,
        joints=np.array([model.joint(f"joint_{a}").dofadr[0] for a in "xy"[:dof]]),
        hinges=np.array(
            [[model.joint(f"hinge{k}_{a}").dofadr[0] for a in "xy"] for k in range(pairs)]
        ),
        bodies=np.array([model.body(f"link{k}").id for k in range(pairs)]),
    )


def _add_link(plate: Any, p: RigParameters, stiffness_nm_rad: Array, load: Load) -> None:
    width, damping_s = p["link.width_m"], p["stiffness.damping_s"]
    hinges = p.structure.hinges
    piece = p["link.length_m"] / hinges
    density = p["link.mass_kg"] / p["link.length_m"]
    shear = (p["stiffness.wall_shear_n"] + p["stiffness.pressure_pa"] * width**2) / piece
    body, offset = plate, p["link.base_offset_m"]
    for k in range(hinges + 1):
        # The root's piece and the last one are half as long: hinges are in the middle of pieces.
        long = piece if 0 < k < hinges else 0.5 * piece
        mass = density * long
        across = mass * (width**2 + long**2) / 12.0
        body = _body(
            body, f"link{k}", offset, mass, [across, across, mass * width**2 / 6.0], 0.5 * long
        )
        if k > 0:
            for axis, direction in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0))):
                joint = body.add_joint(
                    name=f"shear{k}_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction
                )
                joint.stiffness[0], joint.damping[0] = shear, damping_s * shear
        for axis in "xy":
            joint = _joint(body, f"hinge{k}_{axis}", axis)
            joint.damping[0] = damping_s * stiffness_nm_rad[k]
        for row, height_m in enumerate(p.layout.rows_m):
            # In pieces above the hinge; the root's piece ends below the first hinge of the span.
            above = height_m / p["link.length_m"] * hinges - max(k - 0.5, 0.0)
            if 0.0 <= above < (1.0 if k else 0.5):
                _add_markers(body, row, above * piece, p.layout)
        offset = long
    tip = p["link.tip_mass_kg"] + p["link.extra_tip_mass_kg"]
    _body(body, "tip", offset, tip, [tip * width**2 / 12.0] * 3)
    if load.mass_kg > 0.0:
        payload = _body(
            body, "payload", offset, load.mass_kg,
            [load.mass_kg * p["link.payload_size_m"] ** 2 / 6.0] * 3,
        )  # fmt: skip
        payload.pos[:2] = load.offset_x_m, load.offset_y_m


def _body(
    parent: Any, name: str, z_m: float, mass_kg: float, inertia: list[float], centre_m: float = 0.0
) -> Any:
    return parent.add_body(
        name=name, pos=[0.0, 0.0, z_m], explicitinertial=True,
        mass=mass_kg, inertia=inertia, ipos=[0.0, 0.0, centre_m],
    )  # fmt: skip


def _joint(body: Any, name: str, axis: str) -> Any:
    return body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=AXES[axis])


def _add_markers(body: Any, row: int, z_m: float, layout: MarkerLayout) -> None:
    """Markers of a row, in the order of a trial's columns."""
    for name, (x_m, y_m) in zip(layout.row(row), layout.corners_m, strict=True):
        body.add_site(name=name, pos=[x_m, y_m, z_m])
