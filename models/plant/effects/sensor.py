"""Sensor errors: encoder, current, lag, and frame and clock of the motion capture."""

from __future__ import annotations

from types import MappingProxyType

from models.plant.effects import Effect
from models.plant.parameter import Parameter
from models.plant.scope import Scope, SensorLowPass


class EncoderOffset(Effect):
    """Encoder offset: the servo measures and controls q + δ.

    Angles in trials and logs are the measured ones, q + δ; the true angle of the link is q.
    """

    name = "encoder_offset"
    of_each_joint = True
    per_joint = (
        Parameter("encoder_offset_{j}_{angle}", "rad", 0.0, -0.2, 0.2,
                  "constant error of the measured angle", "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.encoder_error[j] += scope.p("encoder_offset_{j}_{angle}", j)


class CurrentBias(Effect):
    """Constant error of the measured current: i + b."""

    name = "current_bias"
    of_each_joint = True
    needs = ("current",)
    per_joint = (
        Parameter("current_bias_{j}_a", "A", 0.0, -2.0, 2.0,
                  "constant error of the measured current", "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.current_bias[j] += scope.p("current_bias_{j}_a", j)


class CurrentScale(Effect):
    """Relative error of the measured current: (1 + s) i."""

    name = "current_scale"
    needs = ("current",)
    per_joint = (
        Parameter("current_scale_{j}", "1", 0.0, -0.5, 0.5,
                  "relative error of the measured current", "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            scope.current_scale[j] += scope.p("current_scale_{j}", j)


class MarkerFrameTilt(Effect):
    """Tilt of the motion capture's frame about y, R_y(α) r; distances, hence DI, do not change.

    A frame that was set up again is also turned about the other axes, R_y(α) R_x(ρ) R_z(υ) r. With
    two joints the tilt is about their axes, y and x. A turn about another axis belongs to the
    session: a diagnosis refits it within its prior.
    """

    name = "marker_frame_tilt"
    needs = ("tip",)
    shared = (
        Parameter("marker_frame_tilt_rad", "rad", 0.0, -0.2, 0.2,
                  "tilt of the mocap's frame about y", "assumed absent", role="effect"),
        Parameter("marker_frame_roll_rad", "rad", 0.0, -0.2, 0.2,
                  "turn of the mocap's frame about x", "assumed absent", role="calibration",
                  prior_deviation=0.005),
        Parameter("marker_frame_yaw_rad", "rad", 0.0, -0.2, 0.2,
                  "turn of the mocap's frame about z", "assumed absent", role="calibration",
                  prior_deviation=0.005),
    )  # fmt: skip

    @classmethod
    def strengths(cls, scope: Scope) -> tuple[str, ...]:
        return ("marker_frame_tilt_rad", "marker_frame_roll_rad")[: len(scope.joints)]

    def apply(self, scope: Scope) -> None:
        scope.frame_turn_rad = tuple(
            turn + scope.p(f"marker_frame_{name}_rad")
            for turn, name in zip(scope.frame_turn_rad, ("roll", "tilt", "yaw"), strict=True)
        )


class MarkerScale(Effect):
    """Relative error of the motion capture's scale, (1 + s) r about the origin of its frame.

    Markers and tip in the trials contain the error. The Deformation Index compares lengths with
    those at rest, which contain the same error, so it does not change.
    """

    name = "marker_scale"
    needs = ("tip",)
    shared = (
        Parameter("marker_scale", "1", 0.0, -0.2, 0.2, "relative error of the mocap's scale",
                  "assumed absent", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        scope.frame_scale += scope.p("marker_scale")


class SyncOffset(Effect):
    """Lag δ of the motion capture behind the servo's clock: at time t it shows the pose of t − δ.

    q(t − δ) ≈ q − δ q̇ + δ²/2 q̈ of joints and bends, also for a clock ahead of the servo's (δ < 0).
    The remainder is (ωδ)³/6: 2e-5 of the study's motion at 40 ms, 5 % of a vibration at 2.5 Hz.
    """

    name = "sync_offset"
    needs = ("tip",)
    shared = (
        Parameter("sync_offset_s", "s", 0.0, -0.08, 0.08,
                  "delay of the mocap's clock behind the servo's",
                  "assumed absent; 10 ms count as synchronised", role="effect"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        scope.frame_delay_s += scope.p("sync_offset_s")


class SensorLag(Effect):
    """Low-pass of measured signals; the strength is that of the current, 1 / (1 + θ s).

    If no current is modelled or measured, the strength is that of a measured deflection, or else of
    the joint's coordinate (`models.plant.compose`). A fraction of θ may be in a
    second stage. A low-pass also removes the saw-tooth that a held goal causes in the current. In
    trials without the low-pass, the saw-tooth and viscous friction cannot be separated, because all
    samples have one phase: the plant may have too much of one and too little of the other. So a fit
    corrects the friction in the current together with the lag, in each joint separately.
    Lags of the coordinate and of the motion capture are zero unless a document frees or sets them.
    They subtract T times the rate and add T² times the acceleration, with a remainder of (ωT)³. The
    drive's loops are not delayed, and neither are the driven link and the observer.
    """

    name = "sensor_lag"
    parameter_needs = MappingProxyType({"sensor_lag_jump_{j}": "goal shape"})
    per_joint = (
        Parameter("sensor_lag_{j}_s", "s", 0.0, 0.0, 0.2,
                  "mean delay of the low-pass of the measured current", "assumed absent",
                  role="effect"),
        Parameter("sensor_lag_second_{j}", "1", 0.0, 0.0, 0.5,
                  "fraction of it in a second stage; 0.5 is critically damped",
                  "assumed of first order; uniform: none to two equal stages", role="effect",
                  prior_deviation=0.29),
        Parameter("sensor_lag_jump_{j}", "1", 0.0, -0.5, 0.5,
                  "mean of the current above that of the plant, in jumps of a goal that moves as "
                  "the joint does",
                  "uniform: a saw-tooth spans one jump", role="effect", prior_deviation=0.29),
        Parameter("sensor_lag_angle_{j}_s", "s", 0.0, 0.0, 0.05, "low-pass of the measured angle",
                  "assumed absent"),
    )  # fmt: skip
    shared = (
        Parameter("sensor_lag_mocap_s", "s", 0.0, 0.0, 0.05, "low-pass of the motion capture",
                  "assumed absent"),
    )  # fmt: skip

    def apply(self, scope: Scope) -> None:
        for j in scope.joints:
            second = "sensor_lag_second_{j}"
            shaped = "goal shape" in scope.features
            scope.sensor_lag[j] = SensorLowPass(
                time_s=scope.p("sensor_lag_{j}_s", j),
                second_share=scope.p(second, j) if scope.has(second, j) else None,
                angle_s=scope.p("sensor_lag_angle_{j}_s", j),
                jump_fraction=scope.p("sensor_lag_jump_{j}", j) if shaped else None,
            )
        scope.frame_lag_s += scope.p("sensor_lag_mocap_s")
