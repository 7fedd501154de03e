"""Effects that are periodic in a joint's angle: error of its encoder, torque of its motor.

Both are a sine and a cosine with a known number of periods per turn. The amplitude of the sine is
the strength. Two amplitudes are regular at zero, unlike an amplitude and a phase; the size is
√(sine² + cosine²).
"""

from __future__ import annotations

import functools
from types import MappingProxyType
from typing import Final

import casadi as ca

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Expr, Scope, substitute


def periodic(scope: Scope, prefix: str, joint: int, angle: Expr) -> Expr:
    """Sum a sin(n q) + b cos(n q), with the parameters of the effect `prefix`."""
    suffix = "{angle}" if prefix == EncoderRipple.name else "{torque}"
    turn = scope.p(prefix + "_order_{j}", joint) * angle
    sine = scope.p(prefix + "_{j}_" + suffix, joint)
    cosine = scope.p(prefix + "_cosine_{j}_" + suffix, joint)
    return sine * ca.sin(turn) + cosine * ca.cos(turn)


RATE_FRACTION: Final = Parameter(
    "encoder_ripple_rate", "1", 0.0, -0.5, 1.5, "fraction of the error's rate in the velocity loop",
    "assumed: sensor at the motor", role="effect", prior_deviation=0.5
)  # fmt: skip


class EncoderRipple(Effect):
    """Periodic error of the encoder, q + a sin(n q) + b cos(n q), seen by the servo's loop.

    Its causes are an eccentric or oval scale and unequal signals of the scale's tracks
    (docs/sources.md, "The servo"). A servo with a sensor at the motor measures the rate without the
    error; in a servo with a single encoder the rate contains the error's derivative. The fraction
    of the derivative is fitted. The number of periods is not: a search finds no ripple if the
    plant file has another number than the encoder.
    """

    name = "encoder_ripple"
    search_start = MappingProxyType({RATE_FRACTION.name: 0.5})
    per_joint = (
        Parameter("encoder_ripple_{j}_{angle}", "rad", 0.0, -0.02, 0.02,
                  "sine of the measured angle's periodic error", "assumed absent", role="effect"),
        Parameter("encoder_ripple_cosine_{j}_{angle}", "rad", 0.0, -0.02, 0.02, "its cosine",
                  "assumed absent", role="effect"),
        Parameter("encoder_ripple_order_{j}", "1/rad", 16.0, 1.0, 40.0, "periods per turn",
                  "assumed: pole pairs of the encoder"),
    )  # fmt: skip
    shared = (RATE_FRACTION,)

    def parameters(self, scope: Scope) -> tuple[Parameter, ...]:
        parameters = super().parameters(scope)
        return parameters if "goal shape" in scope.features else parameters[: -len(self.shared)]

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.encoder_ripple[j] = functools.partial(periodic, scope, self.name, j)
            if "goal shape" in scope.features:
                scope.rate_error[j] = functools.partial(_rate_error, scope, j)


def _rate_error(scope: Scope, joint: int, angle: Expr) -> Expr:
    """Error of the rate in the velocity loop as a fraction of the rate."""
    symbol = ca.SX.sym("angle")
    slope = ca.gradient(periodic(scope, EncoderRipple.name, joint, symbol), symbol)
    return scope.p(RATE_FRACTION.name) * substitute(slope, [(symbol, angle)])


class Cogging(Effect):
    """Torque of the motor or its gear on the drive's side, τ = −a sin(n q) − b cos(n q).

    It pulls the joint towards n evenly spaced angles and dissipates no energy. Its causes are slots
    and magnets of a motor, or the teeth of a gear [Hanselman 2003]. It acts on the rotor, so the
    gear does not transmit it. The number of periods is not fitted: a search finds no cogging if the
    plant file has another number than the servo. The amplitude is √(a² + b²).
    """

    name = "cogging"
    per_joint = (
        Parameter("cogging_{j}_{torque}", "N.m", 0.0, -10.0, 10.0,
                  "sine of the torque periodic in the angle", "assumed absent", role="effect"),
        Parameter("cogging_cosine_{j}_{torque}", "N.m", 0.0, -10.0, 10.0, "its cosine",
                  "assumed absent", role="effect"),
        Parameter("cogging_order_{j}", "1/rad", 24.0, 1.0, 200.0, "periods per turn",
                  "assumed: pins of the gear's last stage"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.joint_torque[j] -= periodic(scope, self.name, j, scope.angle[j])
