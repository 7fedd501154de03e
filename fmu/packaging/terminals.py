"""Terminals and icon of an FMU (FMI 3.0, section 2.4.10; FMI 2.0 has model.png only).

A terminal groups variables that are connected together. For example, the terminal `measurement` of
a twin connects to that of an observer, member by member.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal
from xml.etree import ElementTree as ET

from fmu.interface import FmiVariable, Interface

__all__ = ["terminal_files"]

HERE: Final = Path(__file__).parent
_SIZE: Final = 100.0
"""Half of the icon's edge in its coordinates, as in Modelica."""
_SCALE_MM: Final = 0.1
"""Suggested size of a coordinate, as in Modelica's diagrams."""

_GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "goals": ("goal_",),
    "measurement": ("angle_", "current_"),
    "link": ("di", "tip_", "payload_"),
    "prediction": ("predicted_", "in_range", "half_width_"),
}
"""Terminals and the prefixes of their members; an FMU has only those with members."""


def terminal_files(interface: Interface, fmi: Literal[2, 3]) -> dict[str, bytes]:
    """Return the files of terminals and icon by their path in the FMU."""
    picture = (HERE / "icon.png").read_bytes()
    if fmi == 2:
        return {"model.png": picture}
    return {
        "terminalsAndIcons/icon.png": picture,
        "terminalsAndIcons/icon.svg": (HERE / "icon.svg").read_bytes(),
        "terminalsAndIcons/terminalsAndIcons.xml": _description(interface),
    }


def _description(interface: Interface) -> bytes:
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    picture = ET.SubElement(root, "GraphicalRepresentation")
    corners = {"x1": repr(-_SIZE), "y1": repr(-_SIZE), "x2": repr(_SIZE), "y2": repr(_SIZE)}
    ET.SubElement(
        picture, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": repr(_SCALE_MM)}
    )
    ET.SubElement(picture, "Icon", corners)
    groups = {
        f"{name}_{side}" if name in ("link", "payload") and side == "input" else name: members
        for name, begins in _GROUPS.items()
        for side in ("input", "output")
        if (members := _members(interface.of(side), begins))
    }
    if groups:
        terminals = ET.SubElement(root, "Terminals")
        for name, members in groups.items():
            terminal = ET.SubElement(
                terminals, "Terminal", name=name, matchingRule="bus",
                terminalKind="org.dropstitch.signals",
            )  # fmt: skip
            for member in members:
                ET.SubElement(
                    terminal, "TerminalMemberVariable",
                    variableName=member, memberName=member, variableKind="signal",
                )  # fmt: skip
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _members(variables: Sequence[FmiVariable], begins: tuple[str, ...]) -> list[str]:
    return [v.name for v in variables if v.name.startswith(begins)]
