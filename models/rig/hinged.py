"""Hinged link on MuJoCo: its law, its geometry and its engine.

One hinge pair stands for the root patch; another one is in the middle of each of the equal pieces
of the span, eight by default, with a shear pair (two slides). MuJoCo computes inertia, gravity, the
linear shear springs and the Kelvin-Voigt damping; the bending torque is that of `BendLaw`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import casadi as ca
import mujoco
import numpy as np

from models.rig.parameters import RigParameters, link_stiffness
from models.rig.rig import Load, Rig
from models.shared.catalogue import LEAK_TIME_S, REFERENCE_BEND_RAD
from models.shared.kinematics import Array


def size_of(planes: Any) -> Any:
    """Length of a vector (2,) of both planes."""
    return ca.sqrt(planes[0] ** 2 + planes[1] ** 2)


def limited_fraction(parameters: RigParameters, level: Any) -> Any:
    """Moment over that of a link without limit, at a level x of this over the limit moment: f(x)/x.

    Choice `limit`. "tanh": f = tanh(x). "wrinkling": the wall wrinkles above half of the limit,
    f = x, then 1 - 1/(4 x). Half of the collapse moment is a tube's (Comer and Levy, *AIAA Journal*
    1, 1963 [recalled]); that a box has it too (theory: 2/3; docs/sources.md, "The link") and the
    shape are [assumed].
    """
    if parameters.structure.limit == "wrinkling":
        level = ca.fmax(level, 0.5)
        return (1.0 - 0.25 / level) / level
    level = level + 1e-12
    return ca.tanh(level) / level


def relaxation_spectrum(parameters: RigParameters) -> tuple[Array, Array]:
    """Times in s of Maxwell branches, and their fractions of the stiffness.

    Choice `creep`. "branches": three equal ones. "power_law": one per half decade, with the
    spectrum of a fractional element, which falls as tau^-alpha per decade (Mainardi, *Fractional
    Calculus and Waves in Linear Viscoelasticity*, 2010 [recalled]).
    """
    p = parameters
    relaxing = p["memory.relaxing_share"]
    if p.structure.creep == "branches":
        times_s = np.array([p[f"memory.relaxation_{b}_s"] for b in (1, 2, 3)])
        return times_s, np.full(len(times_s), relaxing / len(times_s))
    shortest_s, longest_s = p["memory.power_shortest_s"], p["memory.power_longest_s"]
    count = 1 + round(2.0 * np.log10(longest_s / shortest_s))
    times_s = np.geomspace(shortest_s, longest_s, count)
    weights = times_s ** -p["memory.power_exponent"]
    return times_s, relaxing * weights / weights.sum()


def hysteresis_springs(parameters: RigParameters) -> int:
    slips = parameters.structure.hysteresis == "maxwell_slip"
    return round(parameters["memory.slip_elements"]) if slips else 1


def slide(
    parameters: RigParameters,
    yield_rad: float,
    stiffness_nm_rad: float,
    memory: Sequence[Any],
    du: Any,
) -> tuple[list[Any], Any]:
    """Friction of the link's skin: state after a further bend du (2,) in rad, and moment in N·m.

    `memory` is an array (2,) for each of `hysteresis_springs`, zero when relaxed. Sliding, a pair
    of stiffness K and yield u_y has the moment kappa K u_y. A small bend du from rest gives
    kappa K du in every form, so that a strength is the same fraction of the stiffness. Each form
    stores energy in a spring and dissipates it in a slider. Choice `hysteresis`:

    * "bouc_wen": dz = du/u_y - (|z.du| + z.du) z / (2 u_y) (Park, Wen and Ang, 1986 [recalled]);
    * "dahl": dz = du/u_y - |du| z / u_y (Dahl, 1968; exponent 1, in two planes);
    * "maxwell_slip": springs of equal stiffness with sliders of different yields in parallel (Iwan,
      *J. Applied Mechanics* 33, 1966 [recalled]); a spring beyond its yield is returned radially.

    The moment of the first two is kappa K u_y z; z is integrated implicitly.
    """
    p = parameters
    friction_nm = p["memory.hysteresis_share"] * stiffness_nm_rad * yield_rad
    if p.structure.hysteresis == "maxwell_slip":
        yields = np.geomspace(1.0, p["memory.slip_range"], len(memory))
        after = []
        for stretch, slip_rad in zip(memory, yields / yields.mean() * yield_rad, strict=True):
            stretched = stretch + du
            after.append(stretched * (slip_rad / ca.fmax(size_of(stretched), slip_rad)))
        return after, friction_nm / yield_rad / len(memory) * sum(after)
    (z,) = memory
    if p.structure.hysteresis == "dahl":
        shed = 1.0 + size_of(du) * (1.0 / yield_rad)
    else:
        along = z[0] * du[0] + z[1] * du[1]
        shed = 1.0 + (ca.fabs(along) + along) * (0.5 / yield_rad)
    z = (z + 1.0 / yield_rad * du) / shed
    return [z], friction_nm * z


class Pair(NamedTuple):
    """Numbers of a hinge pair: of the root, or of a part of the span."""

    stiffness_nm_rad: float
    limit_nm: float
    yield_rad: float
    reference_per_rad: float  # Inverse of the bend at which softening and hardening are defined
    prebend_rad: float


class BendLaw:
    """Torque of all n hinge pairs, the root's first, and the state of their memory.

    The moment m is that of a fabric that is elastic, relaxes and slides, M, bounded by the pressure
    that keeps the walls tight. Against a measure of bend u,

        u = S skew(phi - phi_0),     tau = -(du/dphi)^T m,
        M = K u (1 + h |u|^2) / (1 + c |u|) + s_1 + s_2 + ... + friction,
        m = M f(x)/x,     x = |M| / M_c,

    with softening c and hardening h, and Maxwell branches ds/dt = g K du/dt - s/tau. The limit M_c
    bounds the whole moment, because collapse is an equilibrium of pressure: limit loads of inflated
    panels and tubes are in proportion to it (Wielgosz and Thomas, *Thin-Walled Structures* 40,
    2002; 42, 2004 [recalled]). MuJoCo's Kelvin-Voigt damper acts beside it: air and yarns, not
    tight walls, carry it [assumed].

    Passivity. For any `skew` (directional stiffness) and S (coupling of the planes) the power taken
    is m . du/dt. Springs and Maxwell branches in parallel are a spring and Kelvin elements in
    series, u = a M + sum b_i z_i, dz_i/dt = n_i (M - z_i), with a, b_i, n_i > 0. With F the
    integral of the limit law, m = F'(M), the store a F(M) + sum b_i F(z_i) never grows by more than
    the power taken, because F is convex: no path can create energy. For one branch it is
    F(M) / (K (1 + g)) + g / (1 + g) F(K e) / K, e its relaxed bend. With friction, softening or
    hardening besides there is no such proof; in tests no closed path yields energy.

    One CasADi function advances all pairs: a step is about a thousand operations on a few numbers
    each, for which NumPy would need most of its time in calls. It is bound to arrays, because
    passing them as arguments takes ten times as long. CasADi stores a matrix (2, n) by columns as
    NumPy stores the shape (n, 2) by rows.
    """

    def __init__(self, parameters: RigParameters, step_s: float) -> None:
        p, hinges = parameters, parameters.structure.hinges
        self._p, self._step_s = p, step_s
        link = link_stiffness(p)
        root = Pair(
            link.root_nm_rad, link.root_limit_nm, p["memory.root_yield_rad"],
            1.0 / REFERENCE_BEND_RAD, 0.0,
        )  # fmt: skip
        span = Pair(
            link.bending_n_m2 * hinges / p["link.length_m"], link.span_limit_nm,
            p["memory.span_yield_rad"] / hinges, hinges / REFERENCE_BEND_RAD,
            p["stiffness.prebend_rad"] / hinges,
        )  # fmt: skip
        pairs = [root, *[span] * hinges]
        self.stiffness_nm_rad = np.array([pair.stiffness_nm_rad for pair in pairs])
        self._remaining_share = 1.0 - p["stiffness.leak_share"]

        laws = {pair: self._law(pair) for pair in (root, span)}
        width = laws[root].size2_in(1)
        angle_rad = ca.SX.sym("angle_rad", 2, len(pairs))
        memory = [ca.SX.sym("memory", 2, width) for _ in pairs]
        remaining = ca.SX.sym("remaining")
        torques_nm, memory_after = zip(*(
            laws[pair](angle_rad[:, k], memory[k], remaining) for k, pair in enumerate(pairs)
        ), strict=True)  # fmt: skip
        advance = ca.Function(
            "advance", [angle_rad, ca.horzcat(*memory), remaining],
            [ca.horzcat(*torques_nm), ca.horzcat(*memory_after)],
        )  # fmt: skip

        self._angle_rad, self._torque_nm = np.zeros((2, len(pairs), 2))
        self._memory, self._memory_after = np.zeros((2, len(pairs), width, 2))
        self._remaining = np.ones(1)
        for k, pair in enumerate(pairs):  # the link is relaxed at zero
            self._memory[k, 0] = self._measure(pair, ca.DM.zeros(2))[0].full()[:, 0]
        buffer: Any
        buffer, self._evaluate = advance.buffer()
        for k, array in enumerate((self._angle_rad, self._memory, self._remaining)):
            buffer.set_arg(k, array.data)
        # Results are written while arguments are still read, so the memory has two arrays.
        for k, array in enumerate((self._torque_nm, self._memory_after)):
            buffer.set_res(k, array.data)
        self._buffer = buffer  # the function does not keep it alive

    def torque_nm(self, angle_rad: Array, leaking_s: float = 0.0) -> Array:
        """Advance the memory to these angles and return the restoring torque in N·m, shape (n, 2).

        `angle_rad` (n, 2) are the hinge angles towards +x and +y, one step after the last call.
        """
        self._angle_rad[:] = angle_rad
        if leaking_s:
            self._remaining[0] = self._remaining_share ** (leaking_s / LEAK_TIME_S)
        self._evaluate()
        self._memory[:] = self._memory_after
        return self._torque_nm.copy()

    def _law(self, pair: Pair) -> ca.Function:
        """Function (angles, memory, remaining stiffness) -> (torque, memory after the step)."""
        p, step_s, stiffness_nm_rad = self._p, self._step_s, pair.stiffness_nm_rad
        times_s, fractions = relaxation_spectrum(p)
        memory = ca.SX.sym("memory", 2, 1 + len(times_s) + hysteresis_springs(p))
        u_before, *rest = ca.horzsplit(memory)
        branches_nm, slid = rest[: len(times_s)], rest[len(times_s) :]
        angle_rad, remaining = ca.SX.sym("angle_rad", 2), ca.SX.sym("remaining")

        u, slope = self._measure(pair, angle_rad)
        du = u - u_before
        decays = np.exp(-step_s / times_s)
        # Exact for a bend that grows at a constant rate over the step.
        gains = fractions * times_s * -np.expm1(-step_s / times_s) / step_s
        relaxed_nm = [
            decay * branch_nm + gain * stiffness_nm_rad * du
            for decay, gain, branch_nm in zip(decays, gains, branches_nm, strict=True)
        ]
        slid_after, friction_nm = slide(p, pair.yield_rad, stiffness_nm_rad, slid, du)

        size, soft = size_of(u), p["stiffness.softening_share"]
        softer = soft / (1.0 - soft) * pair.reference_per_rad
        harder = p["stiffness.hardening_share"] * pair.reference_per_rad**2
        secant_nm_rad = stiffness_nm_rad * (1.0 + harder * size**2) / (1.0 + softer * size)
        whole_nm = secant_nm_rad * u + sum(relaxed_nm) + friction_nm
        moment_nm = limited_fraction(p, size_of(whole_nm) * (1.0 / pair.limit_nm)) * whole_nm
        torque_nm = -remaining * slope * self._mixed(moment_nm)
        memory_after = ca.horzcat(u, *relaxed_nm, *slid_after)
        return ca.Function("law", [angle_rad, memory, remaining], [torque_nm, memory_after])

    def _measure(self, pair: Pair, angle_rad: Any) -> tuple[Any, Any]:
        """Measure of bend u and the diagonal of its derivative before coupling, shape (2,)."""
        p = self._p
        skew = 0.5 * p["stiffness.directional_share"]
        rounding_rad = p["stiffness.directional_rounding"] * pair.yield_rad
        phi = angle_rad - ca.DM([pair.prebend_rad, 0.0])
        root = ca.sqrt(phi**2 + rounding_rad**2)
        return self._mixed(phi + skew * (root - rounding_rad)), 1.0 + skew * phi / root

    def _mixed(self, planes: Any) -> Any:
        """Couple both planes; shape (2,)."""
        coupling = 0.5 * self._p["stiffness.coupling_share"]
        return ca.DM([[1.0, coupling], [coupling, 1.0]]) @ planes


AXES: Final = {"x": (0.0, 1.0, 0.0), "y": (-1.0, 0.0, 0.0)}
"""Axis about which a positive angle moves the tip towards +x and +y."""


def robot_model(
    parameters: RigParameters, dof: int, load: Load, stiffness_nm_rad: Array
) -> mujoco.MjModel:
    """MuJoCo model of yoke, plate, link, tip and markers; the second joint may be rigid.

    It has only hinges and slides, so positions and rates have the same addresses.
    """
    p = parameters
    spec = mujoco.MjSpec()
    spec.option.timestep = p["world.step_s"]
    spec.option.gravity = load.gravity_m_s2
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
    _add_link(plate, p, load, stiffness_nm_rad)
    return spec.compile()


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
        for axis in AXES:
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
    if load.payload_kg > 0.0:
        inertia = [load.payload_kg * p["link.payload_size_m"] ** 2 / 6.0] * 3
        payload = _body(body, "payload", offset, load.payload_kg, inertia)
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
    """`Rig` on MuJoCo."""

    def __init__(self, parameters: RigParameters, dof: int, load: Load) -> None:
        p, pairs = parameters, parameters.structure.hinges + 1
        super().__init__(p, dof, p["world.step_s"])
        self.bending_law = BendLaw(p, self.step_s)
        self.model = model = robot_model(p, dof, load, self.bending_law.stiffness_nm_rad)
        # Addresses of the driven joints (dof,) and of the hinges (n, 2): the root first, and
        # the columns bend towards +x and +y.
        self.joints = np.array([model.joint(f"joint_{a}").dofadr[0] for a in "xy"[:dof]])
        self.hinges = np.array(
            [[model.joint(f"hinge{k}_{a}").dofadr[0] for a in AXES] for k in range(pairs)]
        )
        self.data = mujoco.MjData(model)
        mujoco.mj_forward(model, self.data)
        # MuJoCo's arrays stay in place: views of them save a look-up and a copy per step.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._applied_nm = self.data.qfrc_applied
        self._drives = list(zip(self.servos, self.joints.tolist(), strict=True))
        pieces = slice(model.body("link0").id, model.body(f"link{pairs - 1}").id + 1)
        self._body_centres = self.data.xipos[pieces]
        self._centres = self._body_centres.copy()
        # Force per speed squared of each piece, such that 1 rad/s about joint 1 gives `drag_nm`;
        # the area of a uniform link is as its mass.
        area, height = model.body_mass[pieces], self._centres[:, 2]
        self._drag = (p["world.drag_nm"] * (area / np.sum(area * height**3)))[:, None]
        self._drag_n = self.data.xfrc_applied[pieces, :3]

    @property
    def joint_rad(self) -> list[float]:
        return [float(angle) for angle in self.data.qpos[self.joints]]

    @property
    def link_markers_m(self) -> Array:
        return np.asarray(self.data.site_xpos)  # MuJoCo updates sites before it moves the bodies

    @property
    def largest_bend_rad(self) -> float:
        # MuJoCo counts states that are not finite and restarts from zero after each.
        if any(self.data.warning[w].number for w in UNSTABLE_WARNINGS):
            return np.nan
        return float(np.max(np.abs(self.data.qpos[self.hinges])))

    def advance(self) -> None:
        time_s, hinges = self.time_s, self.hinges
        qpos, qvel, applied_nm = self._qpos, self._qvel, self._applied_nm
        for servo, joint in self._drives:
            torque = servo.step(time_s, float(qpos[joint]), float(qvel[joint]))
            applied_nm[joint] = torque + servo.load_nm
        applied_nm.put(hinges, self.bending_law.torque_nm(qpos.take(hinges), self.leaking_s))
        self._update_drag()
        mujoco.mj_step(self.model, self.data)

    def _update_drag(self) -> None:
        velocity = (self._body_centres - self._centres) / self.step_s
        x, y, z = velocity.T
        speed = np.sqrt(x * x + y * y + z * z)[:, None]
        np.multiply(-(self._drag * speed), velocity, out=self._drag_n)
        np.copyto(self._centres, self._body_centres)
