"""Hinged link on MuJoCo: its law, its geometry and its engine.

One hinge pair stands for the root patch; another one is in the middle of each of the equal pieces
of the span, eight by default, with a shear pair (two slides). MuJoCo computes inertia, gravity, the
linear shear springs and the Kelvin-Voigt damping; the bending torque is that of `BendLaw`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import casadi as ca
import mujoco
import numpy as np

from models.rig.forms import (
    both_planes,
    hysteresis_form,
    limited_fraction,
    relaxation_spectrum,
    size_of,
)
from models.rig.parameters import RigParameters, link_stiffness
from models.rig.rig import DOWN, Load, Rig, gravity_m_s2, tip_load
from models.shared.catalogue import LEAK_TIME_S, REFERENCE_BEND_RAD
from models.shared.kinematics import Array


class InPlaceFunction:
    """CasADi function bound to the arrays of its arguments and results.

    A call takes some microseconds; passing the arrays as arguments takes ten times as long. Arrays
    are contiguous float64; a CasADi matrix is stored by columns. Results must not share memory with
    arguments, because they are written while arguments are still read.
    """

    def __init__(
        self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array]
    ) -> None:
        sizes = [function.numel_in(k) for k in range(function.n_in())]
        sizes += [function.numel_out(k) for k in range(function.n_out())]
        if sizes != [array.size for array in (*arguments, *results)]:
            raise ValueError(f"{function.name()} has {sizes} elements")
        buffer: Any
        buffer, self._evaluate = function.buffer()
        for k, array in enumerate(arguments):
            buffer.set_arg(k, array.data)
        for k, array in enumerate(results):
            buffer.set_res(k, array.data)
        self._kept_alive = buffer, (*arguments, *results)

    def __call__(self) -> None:
        self._evaluate()


class BendLaw:
    """Torque of all n hinge pairs, the root's first, and the state of their memory.

    The moment m is that of a fabric that is elastic, relaxes and slides, M, bounded by the pressure
    that keeps the walls tight. Against a measure of bend u,

        u = S skew(phi - phi_0),     tau = -(du/dphi)^T m,
        M = K u (1 + h |u|^2) / (1 + c |u|) + s_1 + s_2 + ... + friction,
        m = M f(x)/x,     x = |M| / M_c,

    with softening c and hardening h, Maxwell branches ds/dt = g K du/dt - s/tau, and the forms of
    spectrum, friction and limit f of `models.rig.forms`. The limit M_c bounds the whole moment,
    because collapse is an equilibrium of pressure: limit loads of inflated panels and tubes are in
    proportion to it (Wielgosz and Thomas, *Thin-Walled Structures* 40, 2002; 42, 2004 [recalled]).
    MuJoCo's Kelvin-Voigt damper acts beside it: air and yarns, not tight walls, carry it [assumed].

    Passivity. For any `skew` (directional stiffness) and S (coupling of the planes) the power taken
    is m . du/dt. Springs and Maxwell branches in parallel are a spring and Kelvin elements in
    series, u = a M + sum b_i z_i, dz_i/dt = n_i (M - z_i), with a, b_i, n_i > 0. With F the
    integral of the limit law, m = F'(M), the store a F(M) + sum b_i F(z_i) never grows by more than
    the power taken, because F is convex: no path can create energy. For one branch it is
    F(M) / (K (1 + g)) + g / (1 + g) F(K e) / K, e its relaxed bend. With friction, softening or
    hardening besides there is no such proof; in tests no closed path yields energy.

    One CasADi function advances all pairs: a step is about a thousand operations on a few numbers
    each, for which NumPy would need most of its time in calls. Both planes of n pairs are a matrix
    of shape (2, n), which CasADi stores by columns as NumPy stores the shape (n, 2) by rows.
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p, hinges = parameters, parameters.structure.hinges
        self._p, self._step_s, self._pairs = p, step_s, hinges + 1
        link = link_stiffness(p)
        self.stiffness_nm_rad = self._per_pair(
            link.root_nm_rad, link.bending_n_m2 * hinges / p["link.length_m"]
        )
        self._limit_nm = self._per_pair(link.root_limit_nm, link.span_limit_nm)
        self._yield_rad = self._per_pair(
            p["memory.root_yield_rad"], p["memory.span_yield_rad"] / hinges
        )
        self._kept_fraction = 1.0 - p["stiffness.leak_share"]

        advance = self._advance()
        self._angle_rad, self._kept = np.zeros(2 * self._pairs), np.ones(1)
        self._memory, self._memory_after = np.zeros((2, advance.numel_in(1)))
        at_zero = self._measure(ca.DM.zeros(2, self._pairs))[0].full()  # where the link is relaxed
        self._memory[: at_zero.size] = at_zero.T.flat
        self._torque_nm = np.zeros((self._pairs, 2))
        self._evaluate = InPlaceFunction(
            advance,
            [self._angle_rad, self._memory, self._kept],
            [self._torque_nm, self._memory_after],
        )

    def torque_nm(self, angle_rad: Array, leaking_s: float = 0.0) -> Array:
        """Advance the memory to these angles and return the restoring torque in N·m, shape (n, 2).

        `angle_rad` (n, 2) are the hinge angles towards +x and +y, one step after the last call.
        """
        self._angle_rad[:] = angle_rad.ravel()
        if leaking_s:
            self._kept[0] = self._kept_fraction ** (leaking_s / LEAK_TIME_S)
        self._evaluate()
        self._memory[:] = self._memory_after
        return self._torque_nm.copy()

    def _per_pair(self, root: float, span: float) -> Array:
        return np.array([root, *[span] * (self._pairs - 1)])

    def _advance(self) -> ca.Function:
        """Function (angles, memory, remaining stiffness) -> (torque, memory after the step)."""
        n = self._pairs
        times_s, fractions = relaxation_spectrum(self._p)
        hysteresis = hysteresis_form(self._p, self._yield_rad, self.stiffness_nm_rad)
        angle_rad = ca.SX.sym("angle_rad", 2, n)
        u_before = ca.SX.sym("u", 2, n)
        branches_nm = [ca.SX.sym("branch_nm", 2, n) for _ in times_s]
        slid = [ca.SX.sym("slid", 2, n) for _ in range(hysteresis.springs)]
        kept = ca.SX.sym("kept")

        u, slope = self._measure(angle_rad)
        du = u - u_before
        decays = np.exp(-self._step_s / times_s)
        # Exact for a bend that grows at a constant rate over the step.
        held = fractions * times_s * -np.expm1(-self._step_s / times_s) / self._step_s
        relaxed_nm = [
            decay * branch_nm + both_planes(share * self.stiffness_nm_rad) * du
            for decay, share, branch_nm in zip(decays, held, branches_nm, strict=True)
        ]
        slid_after, friction_nm = hysteresis.advance(slid, du)
        whole_nm = both_planes(self._secant_nm_rad(u)) * u + sum(relaxed_nm) + friction_nm
        level = size_of(whole_nm) * ca.DM(1.0 / self._limit_nm).T
        moment_nm = both_planes(limited_fraction(self._p, level)) * whole_nm
        torque_nm = -kept * slope * self._mixed(moment_nm)
        memory = [u_before, *branches_nm, *slid]
        memory_after = [u, *relaxed_nm, *slid_after]
        return ca.Function(
            "advance",
            [angle_rad, _stacked(memory), kept],
            [torque_nm, _stacked(memory_after)],
        )

    def _measure(self, angle_rad: Any) -> tuple[Any, Any]:
        """Measure of bend u and the diagonal of its derivative before coupling, shape (2, n)."""
        p = self._p
        rest_rad = np.zeros((2, self._pairs))
        rest_rad[0, 1:] = p["stiffness.prebend_rad"] / (self._pairs - 1)
        skew = 0.5 * p["stiffness.directional_share"]
        rounding_rad = both_planes(p["stiffness.directional_rounding"] * self._yield_rad)
        phi = angle_rad - rest_rad
        root = ca.sqrt(phi**2 + rounding_rad**2)
        return self._mixed(phi + skew * (root - rounding_rad)), 1.0 + skew * phi / root

    def _mixed(self, planes: Any) -> Any:
        """Couple both planes; shape (2, n)."""
        coupling = 0.5 * self._p["stiffness.coupling_share"]
        return ca.DM([[1.0, coupling], [coupling, 1.0]]) @ planes

    def _secant_nm_rad(self, u: Any) -> Any:
        """Elastic moment over the bend, without limit, shape (1, n)."""
        p = self._p
        size = size_of(u)
        per_reference = self._per_pair(1.0, self._pairs - 1.0) / REFERENCE_BEND_RAD
        soft = p["stiffness.softening_share"]
        softer = ca.DM(soft / (1.0 - soft) * per_reference).T
        harder = ca.DM(p["stiffness.hardening_share"] * per_reference**2).T
        stiffness_nm_rad = ca.DM(self.stiffness_nm_rad).T
        return stiffness_nm_rad * (1.0 + harder * size**2) / (1.0 + softer * size)


def _stacked(parts: list[Any]) -> Any:
    return ca.vertcat(*[ca.vec(part) for part in parts])


AXES: Final = {"x": (0.0, 1.0, 0.0), "y": (-1.0, 0.0, 0.0)}
"""Axis about which a positive angle moves the tip towards +x and +y."""


class MujocoLink:
    """MuJoCo model of the robot: yoke, plate, link, tip, markers; the second joint may be rigid.

    Attributes
    ----------
    model : mujoco.MjModel
        Only hinges and slides, so positions and rates have the same addresses.
    joints : ndarray
        Addresses of the driven joints, (dof,).
    hinges : ndarray
        Addresses of the link's hinges, (n, 2), root first; the columns bend towards +x and +y.
    bodies : ndarray
        Ids of the link's pieces, (n,).
    """

    def __init__(
        self, parameters: RigParameters, dof: int, load: Load, down_m_s2: Array, law: BendLaw
    ) -> None:
        p, pairs = parameters, parameters.structure.hinges + 1
        spec = mujoco.MjSpec()
        spec.option.timestep = p["world.step_s"]
        spec.option.gravity = down_m_s2
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags = int(
            mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        )
        frame = [p["link.frame_inertia_kg_m2"]] * 3
        yoke = _body(spec.worldbody, "yoke", 0.0, p["link.yoke_mass_kg"], frame)
        _hinge(yoke, "joint_x", "x")
        plate = _body(yoke, "plate", 0.0, 0.0, [0.0] * 3)
        if dof == 2:
            _hinge(plate, "joint_y", "y")
        _body(plate, "base", p["link.base_offset_m"], p["link.plate_mass_kg"], frame)
        _add_link(plate, p, load, law.stiffness_nm_rad)
        self.model = model = spec.compile()
        self.joints = np.array([model.joint(f"joint_{a}").dofadr[0] for a in "xy"[:dof]])
        self.hinges = np.array(
            [[model.joint(f"hinge{k}_{a}").dofadr[0] for a in "xy"] for k in range(pairs)]
        )
        self.bodies = np.array([model.body(f"link{k}").id for k in range(pairs)])


def _add_link(plate: Any, p: RigParameters, load: Load, stiffness_nm_rad: Array) -> None:
    width, damping_s = p["link.width_m"], p["stiffness.damping_s"]
    hinges = p.structure.hinges
    piece = p["link.length_m"] / hinges
    density = p["link.mass_kg"] / p["link.length_m"]
    shear = link_stiffness(p).shear_n / piece
    body, offset = plate, p["link.base_offset_m"]
    for k in range(hinges + 1):
        # The root's piece and the last one are half as long: hinges are in the middle of pieces.
        long = piece if 0 < k < hinges else 0.5 * piece
        mass = density * long
        across = mass * (width**2 + long**2) / 12.0
        inertia = [across, across, mass * width**2 / 6.0]
        body = _body(body, f"link{k}", offset, mass, inertia, 0.5 * long)
        for axis, direction in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0))) if k else ():
            joint = body.add_joint(
                name=f"shear{k}_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction
            )
            joint.stiffness[0], joint.damping[0] = shear, damping_s * shear
        for axis in "xy":
            joint = _hinge(body, f"hinge{k}_{axis}", axis)
            joint.damping[0] = damping_s * stiffness_nm_rad[k]
        for row, height_m in enumerate(p.layout.rows_m):
            # In pieces above the hinge; the root's piece ends below the first hinge of the span.
            above = height_m / p["link.length_m"] * hinges - max(k - 0.5, 0.0)
            if 0.0 <= above < (1.0 if k else 0.5):
                for name, corner_m in zip(p.layout.row(row), p.layout.corners_m, strict=True):
                    body.add_site(name=name, pos=[*corner_m, above * piece])
        offset = long
    tip = p["link.tip_mass_kg"] + p["link.extra_tip_mass_kg"]
    _body(body, "tip", offset, tip, [tip * width**2 / 12.0] * 3)
    if load.mass_kg > 0.0:
        inertia = [load.mass_kg * p["link.payload_size_m"] ** 2 / 6.0] * 3
        payload = _body(body, "payload", offset, load.mass_kg, inertia)
        payload.pos[:2] = load.offset_x_m, load.offset_y_m


def _body(
    parent: Any, name: str, z_m: float, mass_kg: float, inertia: list[float], centre_m: float = 0.0
) -> Any:
    return parent.add_body(
        name=name, pos=[0.0, 0.0, z_m], explicitinertial=True,
        mass=mass_kg, inertia=inertia, ipos=[0.0, 0.0, centre_m],
    )  # fmt: skip


def _hinge(body: Any, name: str, axis: str) -> Any:
    return body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=AXES[axis])


UNSTABLE_WARNINGS: Final = (
    mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)  # fmt: skip
"""Warnings with which MuJoCo resets the state."""
if mujoco.get_mju_user_warning() is None:  # else each goes to a file in the working directory
    mujoco.set_mju_user_warning(lambda message: None)


class MujocoRig(Rig):
    """`Rig` on MuJoCo; `models.rig.protocol.build_rig` describes the arguments."""

    def __init__(
        self,
        parameters: RigParameters,
        dof: int,
        payload_kg: float,
        eccentricity_m: tuple[float, float] = (0.0, 0.0),
        gravity: tuple[float, float, float] = DOWN,
    ) -> None:
        p = parameters
        super().__init__(p, dof, p["world.step_s"])
        self.bending_law = BendLaw(p, self.step_s)
        load = tip_load(p, payload_kg, eccentricity_m)
        self.link = MujocoLink(p, dof, load, gravity_m_s2(p, gravity), self.bending_law)
        self.data = mujoco.MjData(self.link.model)
        mujoco.mj_forward(self.link.model, self.data)
        # MuJoCo's arrays stay in place: views of them save a look-up and a copy per step.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._applied_nm = self.data.qfrc_applied
        self._drives = list(zip(self.servos, self.link.joints.tolist(), strict=True))
        self._dragged = p["world.drag_nm"] != 0.0
        pieces = slice(self.link.bodies[0], self.link.bodies[-1] + 1)  # bodies are consecutive
        self._body_centres = self.data.xipos[pieces]
        self._centres = self._body_centres.copy()
        self._set_drag = InPlaceFunction(
            self._drag(p["world.drag_nm"]),
            [self._body_centres, self._centres],
            [self.data.xfrc_applied[pieces]],
        )

    @property
    def joint_rad(self) -> list[float]:
        return [float(angle) for angle in self.data.qpos[self.link.joints]]

    @property
    def link_markers_m(self) -> Array:
        return np.asarray(self.data.site_xpos)  # MuJoCo updates sites before it moves the bodies

    @property
    def largest_bend_rad(self) -> float:
        # MuJoCo counts states that are not finite and restarts from zero after each.
        if any(self.data.warning[w].number for w in UNSTABLE_WARNINGS):
            return np.nan
        return float(np.max(np.abs(self.data.qpos[self.link.hinges])))

    def step(self) -> None:
        time_s, hinges = self.time_s, self.link.hinges
        qpos, qvel, applied_nm = self._qpos, self._qvel, self._applied_nm
        for servo, joint in self._drives:
            torque = servo.step(time_s, float(qpos[joint]), float(qvel[joint]))
            applied_nm[joint] = torque + servo.load_nm
        applied_nm.put(hinges, self.bending_law.torque_nm(qpos.take(hinges), self.leaking_s))
        if self._dragged:
            self._set_drag()
            np.copyto(self._centres, self._body_centres)
        if not self._play.absent:
            self._play.advance([servo.gear_nm for servo in self.servos])
        mujoco.mj_step(self.link.model, self.data)
        self._steps += 1

    def _drag(self, drag_nm: float) -> ca.Function:
        """Function (centres of the pieces now, a step earlier) -> their wrenches, shape (6, n).

        Force per speed squared of each piece is such that 1 rad/s about joint 1 gives `drag_nm`.
        """
        height = self.data.xipos[self.link.bodies, 2]
        area = self.link.model.body_mass[self.link.bodies]  # uniform: as the mass
        coefficients = ca.DM(drag_nm * np.asarray(area / np.sum(area * height**3))).T
        now_m, before_m = (ca.SX.sym(name, 3, coefficients.numel()) for name in ("now", "before"))
        velocity = (now_m - before_m) / self.step_s
        speed = ca.sqrt(ca.sum1(velocity**2))
        force_n = -ca.repmat(coefficients * speed, 3, 1) * velocity
        wrench = ca.densify(ca.vertcat(force_n, ca.SX.zeros(3, coefficients.numel())))
        return ca.Function("drag", [now_m, before_m], [wrench])
