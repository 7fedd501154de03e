"""Source code in an FMU: folder sources/, its build description, and the list for FMI 2.0.

The headers of the standard are not included, because importers have them (FMI 2.0, section 2.3;
FMI 3.0, section 2.5.1.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

__all__ = ["add_source_files", "source_files"]


def source_files(
    name: str, fmi: Literal[2, 3], sources: Sequence[Path], headers: Sequence[Path]
) -> dict[str, bytes]:
    """Return the files under sources/."""
    files = {f"sources/{path.name}": path.read_bytes() for path in (*sources, *headers)}
    if fmi == 3:
        files["sources/buildDescription.xml"] = _build_description(name, sources)
    return files


def add_source_files(description: ET.Element, sources: Sequence[str]) -> None:
    """List the C files in a model description of FMI 2.0, for each type of interface."""
    for tag in ("ModelExchange", "CoSimulation"):
        for interface in description.iter(tag):
            files = ET.Element("SourceFiles")
            for source in sources:
                ET.SubElement(files, "File", name=source)
            interface.insert(0, files)


def _build_description(name: str, sources: Sequence[Path]) -> bytes:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    group = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        ET.SubElement(group, "SourceFile", name=source.name)
    # Without this definition CasADi's functions would be exported; importers need only FMI's.
    ET.SubElement(group, "PreprocessorDefinition", name="CASADI_SYMBOL_EXPORT", value="")
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
