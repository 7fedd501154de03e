"""FMUs unpacked and stepped in FMPy, with one interface for FMI 2.0 and FMI 3.0."""

from __future__ import annotations

import contextlib
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, Literal

import fmpy
import numpy as np
from fmpy.simulation import instantiate_fmu
from numpy.typing import NDArray

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import ARCHIVE_DAMAGE, check_archive, open_bounded
from firmware_py.inference.fmu_instance import check_elf, platform_here
from fmu.packaging import PLATFORMS

InterfaceType = Literal["CoSimulation", "ModelExchange"]

Array = NDArray[np.float64]


class FmuArchive:
    """Unpacked FMU; as a context manager it removes the unpacked files at the end."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        remedy = "build one with 'dropstitch fmu build'"
        try:
            with (
                open_bounded(self.path, remedy) as file,
                zipfile.ZipFile(file) as archive,
            ):
                check_archive(archive, self.path, remedy)
        except ARCHIVE_DAMAGE as error:
            raise InputError(path, f"is not an FMU ({error})", remedy) from None
        self.directory = Path(mkdtemp(prefix="dropstitch-fmu-"))
        try:
            fmpy.extract(str(self.path), str(self.directory))
            self.description = fmpy.read_model_description(str(self.directory), validate=False)
        except Exception as error:  # zip, XML and FMPy raise different types
            self.close()
            reason = str(error).strip().splitlines() or ["damaged"]
            raise InputError(path, f"is not an FMU ({reason[0]})", remedy) from None
        if self.description.coSimulation is None or self.description.fmiVersion[0] not in "23":
            self.close()
            raise InputError(path, "is not an FMI 2.0 or 3.0 FMU for Co-Simulation", remedy)

    @property
    def fmi(self) -> int:
        return int(self.description.fmiVersion[0])

    def binary(self) -> Path:
        here = platform_here()
        name = self.description.coSimulation.modelIdentifier
        if (platform := PLATFORMS.get(here)) is not None:
            folder = platform.folder(here, 2 if self.fmi == 2 else 3)
            path = self.directory / "binaries" / folder / f"{name}{platform.suffix}"
            if path.is_file():
                return path
        raise InputError(
            self.path, f"holds no library for {here}", f"build it with --platforms {here}"
        )

    def instance(self, interface_type: InterfaceType = "CoSimulation") -> FmpyInstance:
        """Instantiate the FMU; several instances may exist at once.

        Only an instance for co-simulation can `step` and `run`.
        """
        return FmpyInstance(self, interface_type)

    def close(self) -> None:
        shutil.rmtree(self.directory, ignore_errors=True)

    def __enter__(self) -> FmuArchive:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class FmpyInstance:
    """Instance of an FMU, with variables by name and Booleans as 1 and 0."""

    def __init__(self, archive: FmuArchive, interface_type: InterfaceType = "CoSimulation") -> None:
        self.fmi = archive.fmi
        self.messages: list[str] = []
        self.variables = {v.name: v for v in archive.description.modelVariables}
        # A logger is always given, because FMPy does not keep its own alive.
        try:
            check_elf(archive.binary().read_bytes())
            with contextlib.chdir("."):  # after an error FMPy stays in the library's directory
                self.fmu: Any = instantiate_fmu(
                    str(archive.directory), archive.description, interface_type,
                    debug_logging=True, logger=self._log,
                )  # fmt: skip
        except InputError:
            raise
        except Exception as error:  # FMPy raises no narrower type
            reason = self.messages[-1] if self.messages else error
            raise InputError(
                archive.path, f"cannot be instantiated ({reason})",
                "build the FMU again, or set TMPDIR to a directory from which programs may run",
            ) from None  # fmt: skip
        self.time_s = 0.0

    def _log(self, *arguments: Any) -> None:
        """Store the message, which is the last argument in both versions."""
        message = arguments[-1]
        self.messages.append(message.decode() if isinstance(message, bytes) else str(message))

    def initialize(
        self, start: Mapping[str, float] | None = None, stop_s: float | None = None
    ) -> None:
        """Set start values and pass through initialization mode."""
        self.set(start or {})
        if self.fmi == 2:
            self.fmu.setupExperiment(startTime=0.0, stopTime=stop_s)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0, stopTime=stop_s)
        self.fmu.exitInitializationMode()
        self.time_s = 0.0

    def set(self, values: Mapping[str, float]) -> None:
        """Set variables by name, in the SI unit of each."""
        references = [self.variables[name].valueReference for name in values]
        if references:
            put = self.fmu.setReal if self.fmi == 2 else self.fmu.setFloat64
            put(references, list(values.values()))

    def get(self, names: Sequence[str]) -> Array:
        """Return the values of variables, shape (n,)."""
        fetch = self.fmu.getReal if self.fmi == 2 else self.fmu.getFloat64
        values = np.empty(len(names))
        booleans = np.array([self.variables[name].type == "Boolean" for name in names], dtype=bool)
        references = np.array([self.variables[name].valueReference for name in names], dtype=int)
        if booleans.any():
            values[booleans] = self.fmu.getBoolean(references[booleans].tolist())
        if not booleans.all():
            values[~booleans] = fetch(references[~booleans].tolist())
        return values

    def step(self, step_s: float) -> None:
        self.fmu.doStep(self.time_s, step_s)
        self.time_s += step_s

    def run(self, inputs: Sequence[str], u: Array, steps_s: Array, outputs: Sequence[str]) -> Array:
        """Initialize with the first row of inputs and take all steps.

        Shapes: `u` (n, len(inputs)), `steps_s` (n,). Returns the outputs at the start and after
        each step, shape (n + 1, len(outputs)).
        """
        self.initialize(dict(zip(inputs, u[0], strict=True)))
        start = self.get(outputs)
        return np.array([start, *self.go_on(inputs, u, steps_s, outputs)])

    def go_on(
        self, inputs: Sequence[str], u: Array, steps_s: Array, outputs: Sequence[str]
    ) -> list[Array]:
        """Take steps from where the instance is; return the outputs after each."""
        rows = []
        for row, step_s in zip(u, steps_s, strict=True):
            self.set(dict(zip(inputs, row, strict=True)))
            self.step(float(step_s))
            rows.append(self.get(outputs))
        return rows

    def close(self) -> None:
        self.fmu.freeInstance()

    def __enter__(self) -> FmpyInstance:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
