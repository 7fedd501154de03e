"""Text of `link.toml` with a comment on every key."""

from __future__ import annotations

from typing import Any

from firmware_py.link.link_description import LinkDescription

_MEANINGS = {
    "gear": "turns of the motor per turn of the output",
    "torque_constant_nm_a": "torque at the output per ampere",
    "coulomb_friction_nm": "friction without load",
    "viscous_friction_nm_s_rad": "friction per speed",
    "load_friction": "friction per transmitted torque",
    "rotor_inertia_kg_m2": "inertia of the rotor, times the gear squared",
    "backlash_rad": "play at the output",
    "current_limit_a": "largest current",
    "speed_limit_rad_s": "speed without load",
    "mass_kg": "of the servo",
}


def link_toml(link: LinkDescription, mass_kg: float, tip_mass_kg: float) -> str:
    """Return the text of a link's file.

    `mass_kg`, `tip_mass_kg`: estimates that replace missing masses of the link.
    """
    gravity, layout = link.gravity, link.layout
    rows = [
        ("schema", link.schema, ""),
        ("name", link.name, "for people"),
        ("joints", link.joints, "driven joints, 1 or 2"),
        ("length_m", link.length_m, "base plate to last marker row"),
        ("width_m", link.width_m, "side or diameter of the section"),
        ("section", link.section, "square or round"),
        ("base_offset_m", link.base_offset_m, "base plate above the joint axes"),
        ("pressure_pa", link.pressure_pa, "inflation"),
        ("payload_kg", round(link.payload_kg, 6), "largest payload"),
    ]
    weighed = [
        ("mass_kg", link.mass_kg, mass_kg, "of the link"),
        ("tip_mass_kg", link.tip_mass_kg, tip_mass_kg, "of the hardware at the tip"),
    ]
    direction = list(gravity.direction) if gravity.direction else None
    lines = [
        "# A link: what trial, plant, rig and robot.toml share (docs/plant/link.md). SI units.",
        *(_row(*row) for row in rows),
        *(
            _row(key, given, f"{what}, weighed")
            if given is not None
            else "# " + _row(key, float(f"{estimated:.3g}"), f"{what}: estimated; weigh it")
            for key, given, estimated, what in weighed
        ),
        "",
        f"# {layout.rows} rows of {layout.corners}; the last row is at the tip.",
        "[markers]",
        _row("rows_m", list(layout.rows_m), "heights above the base plate"),
        "# x and y from the axis, in every row:",
        _row("corners_m", [list(corner) for corner in layout.corners_m], ""),
        "",
        "[gravity]",
        _row("mounting", gravity.mounting, "upright, horizontal, hanging, balloon"),
        _row("effective_weight", gravity.effective_weight, "part of the weight that is left"),
        ("" if direction else "# ")
        + _row("direction", direction or [0.0, 0.0, -1.0], "z along the link at zero angle"),
        "",
        "[servo]",
        _row("model", link.servo.model, ""),
        *(_row(key, getattr(link.preset, key), text) for key, text in _MEANINGS.items()),
        _row("source", link.preset.source, ""),
    ]
    return "\n".join(lines) + "\n"


def _row(key: str, value: Any, meaning: str) -> str:
    """Return one line; the comments are aligned if the value is short enough."""
    text = f'"{_quoted(value)}"' if isinstance(value, str) else repr(value)
    line = f"{key} = {text}"
    return f"{line:34}  # {meaning}" if meaning else line


def _quoted(text: str) -> str:
    return "".join(c for c in text if c.isprintable()).replace("\\", "\\\\").replace('"', '\\"')
