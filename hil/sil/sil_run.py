"""Run in software: the robot's own `ControlLoop` against emulated servos and a simulated plant.

Loop, bus, estimator, predictor, supervisor and recorder are those of the robot, unmodified. Only
the port that they open belongs to the emulator; on the virtual line the clock is simulated as well.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from firmware_py.config import check_config
from firmware_py.core.errors import InputError
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.link.link_description import STUDY_LINK
from hil.emulator.emulator import EmulatorSpecification
from hil.emulator.physics import RigSource, build_twin
from hil.sil.real_time_run import run_in_real_time
from hil.sil.sil_loop import SilResult
from hil.sil.sil_options import SilOptions, sil_config
from hil.sil.virtual_run import run_on_virtual_line
from models.plant.document import read_plant_document

_SIZES: Final = ("base_offset_m", "link_length_m", "link_width_m")


def run_sil(options: SilOptions) -> SilResult:
    """Run the loop against the emulated servos.

    Parameters
    ----------
    options : SilOptions
        Bundle, servo, line, motion and faults.

    Returns
    -------
    SilResult
        The loop's summary and everything measured during the run. The log of a run with
        `SilOptions.log` is in `SilOptions.out`; `hil.sil.write_results` writes the rest.

    Raises
    ------
    InputError
        If the bundle, the FMU or the options cannot be used.
    """
    options.check()
    with TemporaryDirectory(prefix="dropstitch-sil-") as scratch:
        source = options.rig or options.fmu
        if source is None:
            source = build_twin(_plant(options), options.dof, Path(scratch))
        specification = EmulatorSpecification(
            source, options.model.number, options.ids, options.baud,
            latency_s=options.latency_s, payload_kg=options.payload_kg,
            faults=dict(options.faults), seed=options.seed,
        )  # fmt: skip
        check_config(sil_config(options, options.line), "--baud")
        _make(options.out)
        if options.line == "virtual":
            result = run_on_virtual_line(options, specification)
        else:
            result = run_in_real_time(options, options.line, specification, Path(scratch))
        return result._replace(link=_link_conditions(source, options))


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            directory, f"cannot be made a directory ({error.strerror})", "name another --out"
        ) from None


def _plant(options: SilOptions) -> Path:
    path = options.bundle.directory / "plant.json"
    if not path.is_file():
        raise InputError(path, "is missing", "copy the whole bundle, or name a twin with --fmu")
    return path


def _link_conditions(source: Path | RigSource, options: SilOptions) -> dict[str, Any]:
    """Trial conditions given by the simulated link; empty if the plant does not describe one."""
    if isinstance(source, RigSource):
        from hil.emulator.rig_physics import rig_conditions  # loads MuJoCo

        return rig_conditions(source)
    with FmuInstance(source) as opened:
        known = [name for name in _SIZES if f"parameters.{name}" in opened.variables]
        values = opened.get([f"parameters.{name}" for name in known]).tolist()
    if len(known) < len(_SIZES):
        return {}
    plant = options.bundle.directory / "plant.json"
    described = read_plant_document(plant).link if plant.is_file() else None
    return (described or STUDY_LINK).conditions() | dict(zip(known, values, strict=True))
