"""Strength of each hidden effect that shows on a rig."""

STRENGTH = {
    "coulomb_friction": 3.0, "viscous_friction": 5.0, "stribeck_friction": 4.0,
    "load_dependent_friction": 0.2, "backlash": 0.01, "joint_elasticity": 1e-3,
    "dead_time": 0.03, "position_gain_change": 0.2, "current_saturation": 9.3,
    "torque_constant_drift": 0.2, "unmodelled_payload": 0.3, "payload_offset": 0.05,
    "prebend": 0.05,
    "directional_stiffness": 0.3, "stiffness_softening": 0.4, "stiffness_hardening": 2.0,
    "pressure_leak": 0.5, "hysteresis": 0.4, "creep": 0.4, "aerodynamic_drag": 2.0,
    "cross_axis_coupling": 0.2, "encoder_offset": 0.02, "load_offset": 4.0, "current_bias": 0.2,
    "current_scale": 0.1, "marker_frame_tilt": 0.02, "sync_offset": 0.03,
    "sensor_lag": 0.05, "encoder_ripple": 0.01, "cogging": 3.0, "marker_scale": 0.02,
    "stiction": 4.0,
}  # fmt: skip
