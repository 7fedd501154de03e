"""SSP package: the FMUs of twin, observer and controller, and their system structure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from fmu.fmu_builder import build_fmu
from fmu.fmu_models import FmuParts
from fmu.packaging.platforms import HOST
from fmu.packaging.zip_file import build_time_s, date_and_time, write_zip
from fmu.ssp.system_structure import PATHS, system_structure
from fmu.ssp.tip_controller import tip_controller

__all__ = ["build_ssp"]


def build_ssp(
    twin: FmuParts,
    observer: FmuParts,
    output: Path,
    *,
    payload_kg: float = 1.0,
    platforms: Sequence[str] = (HOST,),
) -> Path:
    """Build the package; the observer has to estimate `payload_kg`, the payload of the twin."""
    controller = tip_controller(twin.dof)
    models = dict(zip(PATHS, (controller, twin.model(), observer.model()), strict=True))
    says = {
        "controller": "Controller that leads the tip of the link along a sinusoid.",
        "twin": twin.description(),
        "observer": observer.description(),
    }
    epoch_s = build_time_s()
    name = f"link_{twin.dof}dof"
    structure = system_structure(name, models, payload_kg, date_and_time(epoch_s))
    content = {"SystemStructure.ssd": structure}
    with TemporaryDirectory(prefix="dropstitch-ssp-") as scratch:
        for path, model in models.items():
            built = build_fmu(
                model, Path(scratch) / f"{path}.fmu", fmi=2, description=says[path],
                platforms=platforms,
            )  # fmt: skip
            content[f"resources/{path}.fmu"] = built.read_bytes()
    write_zip(content, output, epoch_s)
    return output
