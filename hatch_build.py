"""Build hook that puts a software bill of materials (SBOM) into the wheel.

The SBOM lists the locked dependencies of the robot image in CycloneDX 1.6 JSON and lies in
`.dist-info/sboms/` (PEP 770). It is a function of `requirements/robot.txt` and the project's
metadata alone: no clock, no random serial number, no address of an index.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LOCK = "requirements/robot.txt"
LOCKED = ("record", "trust")
PIN = re.compile(r"^(?P<name>[a-z0-9-]+)==(?P<version>[^ ;\\]+)(?: ; (?P<marker>[^\\]+?))? *\\?$")


def normalised(requirement: str) -> str:
    """Name of a requirement as PEP 503 writes it."""
    name = re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
    return re.sub(r"[-_.]+", "-", name).lower()


def bill_of_materials(
    name: str, version: str, licence: str, direct: list[str], optional: list[str], lock: str
) -> dict[str, Any]:
    """CycloneDX document of the robot image.

    `direct`, `optional`: requirements of the project, and those of the extras that the lock also
    holds.
    """
    root = f"pkg:pypi/{name}@{version}"
    scopes = {normalised(r): "required" for r in direct}
    scopes |= {normalised(r): "optional" for r in optional}
    components: list[dict[str, Any]] = []
    refs: dict[str, list[str]] = {}
    for line in lock.splitlines():
        if not (pin := PIN.match(line)):
            continue
        ref = f"pkg:pypi/{pin['name']}@{pin['version']}"
        refs.setdefault(pin["name"], []).append(ref)
        component: dict[str, Any] = {
            "type": "library",
            "bom-ref": ref,
            "name": pin["name"],
            "version": pin["version"],
            "purl": ref,
        }
        if pin["name"] in scopes:  # of the others only their parents know
            component["scope"] = scopes[pin["name"]]
        if pin["marker"]:
            component["properties"] = [{"name": "dropstitch:marker", "value": pin["marker"]}]
        components.append(component)
    wanted = [ref for r in [*direct, *optional] for ref in refs[normalised(r)]]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": name,
                "version": version,
                "purl": root,
                "licenses": [{"expression": licence}],
            },
            "properties": [
                {
                    "name": "dropstitch:lock-sha256",
                    "value": hashlib.sha256(lock.encode()).hexdigest(),
                }
            ],
        },
        "components": components,
        "dependencies": [{"ref": root, "dependsOn": sorted(wanted)}],
        # The lock names no edges between libraries, so what they depend on is not stated.
        "compositions": [
            {"aggregate": "unknown", "dependencies": [c["bom-ref"] for c in components]}
        ],
    }


class SbomBuildHook(BuildHookInterface):  # type: ignore[type-arg,misc]
    """Generator of the SBOM for the time of one build."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the SBOM into a directory of its own and hand it to the wheel."""
        core = self.metadata.core
        document = bill_of_materials(
            core.name,
            self.metadata.version,
            core.license_expression,
            core.dependencies,
            [r for extra in LOCKED for r in core.optional_dependencies[extra]],
            (Path(self.root) / LOCK).read_text(encoding="utf-8"),
        )
        self.work = Path(tempfile.mkdtemp(prefix="sbom"))
        file = self.work / f"{core.name}.cdx.json"
        file.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        build_data["sbom_files"].append(str(file))

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the directory."""
        shutil.rmtree(self.work)
