"""FMI 3.0 co-simulation FMU, called through ctypes: the observer of the bundle.

It supports scalars of type Float64 and Boolean and one instance per FMU. The loop uses a
`TickChannel`, whose buffers are allocated once; everything else uses `set` and `get` by name.
"""

from __future__ import annotations

import ctypes
import functools
import io
import platform
import struct
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.core.input_files import ARCHIVE_DAMAGE, Source, check_archive, content_of

_MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64"}
"""FMI name of a processor by the operating system's name in lower case (Windows: capitals)."""


def platform_here() -> str:
    """Return processor and system of this process, like "x86_64-linux" or "aarch64-darwin"."""
    machine = platform.machine().lower()
    return f"{_MACHINES.get(machine, machine)}-{platform.system().lower()}"


_SUFFIXES: Final = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
_FUNCTIONS: Final = (
    "fmi3InstantiateCoSimulation", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode",
    "fmi3SetFloat64", "fmi3GetFloat64", "fmi3GetBoolean", "fmi3DoStep", "fmi3Reset",
    "fmi3FreeInstance",
)  # fmt: skip
"""Functions of the FMI standard that this project calls."""


class InstanceVariable(NamedTuple):
    """Scalar variable of an FMU, as its model description declares it."""

    name: str
    reference: int
    type: str
    causality: str
    unit: str  # SI unit; "1" for none
    start: float | None


def open_fmu(source: Source) -> tuple[ET.Element, dict[str, InstanceVariable], ctypes.PyDLL]:
    """Read the model description with its variables, and load the binary for this machine."""
    remedy = "copy the bundle again, or build it with 'dropstitch fmu build' in a checkout"
    path, data = content_of(source, remedy)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_archive(archive, path, remedy)
            root = ET.fromstring(archive.read("modelDescription.xml"))
            variables = {v.name: v for v in _variables(root)}
            name = _binary(path, root, archive.namelist())
            binary = archive.read(name)
    except (*ARCHIVE_DAMAGE, ET.ParseError) as error:
        raise InputError(path, f"is no FMU ({error})", remedy) from None
    try:
        loaded = _loaded(binary, PurePosixPath(name).name)
    except OSError as error:
        raise InputError(
            path, f"its binary does not load ({error})",
            "build the FMU again, or set TMPDIR to a directory from which programs may run",
        ) from None  # fmt: skip
    absent = [function for function in _FUNCTIONS if not hasattr(loaded, function)]
    if absent:
        raise InputError(path, f"its binary lacks {absent[0]}", remedy)
    return root, variables, loaded


def check_elf(binary: bytes) -> None:
    """Raise OSError if an ELF file ends before its segments do; others are left to the loader.

    The loader maps such a file without an error, and the first access beyond its end kills the
    process (SIGBUS). Layout of the headers: System V ABI, chapter 4, "ELF Header".
    """
    if not binary.startswith(b"\x7fELF"):
        return
    try:
        wide, order = binary[4] == 2, "<" if binary[5] == 1 else ">"
        (first,) = struct.unpack_from(
            f"{order}Q" if wide else f"{order}I", binary, 32 if wide else 28
        )
        size, count = struct.unpack_from(f"{order}2H", binary, 54 if wide else 42)
        header = f"{order}2I4Q" if wide else f"{order}5I"
        for k in range(count):
            fields = struct.unpack_from(header, binary, first + k * size)
            offset, length = (fields[2], fields[5]) if wide else (fields[1], fields[4])
            if offset + length > len(binary):
                raise OSError("the file is cut short")
    except (struct.error, IndexError):
        raise OSError("the file is cut short") from None


@functools.lru_cache(maxsize=16)
def _loaded(binary: bytes, name: str) -> ctypes.PyDLL:
    """Load a library from bytes, cached because a process never unmaps it."""
    check_elf(binary)
    # Windows cannot delete a mapped file: its own clean-up removes the directory later.
    with TemporaryDirectory(prefix="dropstitch-fmu-", ignore_cleanup_errors=True) as private:
        library = Path(private) / name
        library.write_bytes(binary)
        # PyDLL keeps the interpreter's lock: a step takes microseconds, and releasing the lock
        # could cost the loop's thread a switch interval to get it back.
        return ctypes.PyDLL(str(library))  # stays mapped when the file is deleted


def _binary(path: Path, root: ET.Element, names: Iterable[str]) -> str:
    """Return the name of the binary for this machine inside the archive."""
    version = root.get("fmiVersion", "?")
    if not version.startswith("3."):
        raise InputError(path, f"is of FMI {version}", "build it with --fmi 3")
    simulation = root.find("CoSimulation")
    if simulation is None:
        raise InputError(
            path, "is not for Co-Simulation", "build it with 'dropstitch fmu build' in a checkout"
        )
    here = platform_here()
    suffix = _SUFFIXES.get(here.partition("-")[2], ".so")
    name = f"binaries/{here}/{simulation.get('modelIdentifier')}{suffix}"
    if name not in names:
        offered = sorted({n.split("/")[1] for n in names if n.startswith("binaries/")})
        raise InputError(
            path, f"holds no binary for {here}, only for {', '.join(offered) or 'none'}",
            f"build the FMU with '--platforms {here}'",
        )  # fmt: skip
    return name


def _variables(root: ET.Element) -> Iterator[InstanceVariable]:
    for element in root.findall("ModelVariables/*"):
        start = element.get("start") if element.tag == "Float64" else None
        yield InstanceVariable(
            name=element.get("name", ""),
            reference=int(element.get("valueReference", "0")),
            type=element.tag,
            causality=element.get("causality", "local"),
            unit=element.get("unit", "1"),
            start=float(start) if start else None,
        )


Array = NDArray[np.float64]

_LOG = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
_TICK: Final = "dropstitch_tick"
"""Function beyond the standard, see fmu/c/fmi3.c."""
_FMI_WARNING: Final = 1
"""Largest status of a successful call."""


class Channel:
    """Fixed set of variables of an FMU, transferred together through one buffer."""

    def __init__(self, fmu: FmuInstance, names: Sequence[str]) -> None:
        references = [fmu.variable(name, "Float64").reference for name in names]
        self.values: Array = np.zeros(len(references))
        count = ctypes.c_size_t(len(references))
        self._references = (ctypes.c_uint32 * len(references))(*references)
        self._arguments = (
            self._references, count, ctypes.c_void_p(self.values.ctypes.data), count
        )  # fmt: skip
        self._fmu = fmu

    def send(self) -> None:
        self._fmu.call("fmi3SetFloat64", *self._arguments)

    def receive(self) -> None:
        self._fmu.call("fmi3GetFloat64", *self._arguments)


class TickChannel:
    """Inputs, step and outputs of a tick in one call, which FMUs of this project offer.

    Other FMUs need three calls, and their outputs must be of type Float64.
    """

    def __init__(self, fmu: FmuInstance, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._fmu = fmu
        self.inputs: Array = np.zeros(len(inputs))
        self.outputs: Array = np.zeros(len(outputs))
        self._step_s = ctypes.c_double()
        self._references = [
            (ctypes.c_uint32 * len(names))(*(fmu.variable(name).reference for name in names))
            for names in (inputs, outputs)
        ]
        self._arguments = (
            self._references[0], ctypes.c_size_t(len(inputs)),
            ctypes.c_void_p(self.inputs.ctypes.data), self._step_s,
            self._references[1], ctypes.c_size_t(len(outputs)),
            ctypes.c_void_p(self.outputs.ctypes.data),
        )  # fmt: skip
        self._together = fmu.ticks

    def run(self, step_s: float) -> None:
        if self._together:
            self._step_s.value = step_s
            self._fmu.tick(step_s, self._arguments)
            return
        references, count, values, _, outputs, wanted, results = self._arguments
        self._fmu.call("fmi3SetFloat64", references, count, values, count)
        if step_s > 0.0:
            self._fmu.step(step_s)
        self._fmu.call("fmi3GetFloat64", outputs, wanted, results, wanted)


class FmuInstance:
    """Instance of an FMI 3.0 co-simulation FMU.

    It starts in initialization mode, in which values set determine its first state. The first step,
    or `start`, ends this mode.
    """

    def __init__(self, source: Source) -> None:
        content = content_of(
            source, "copy the bundle again, or build it with 'dropstitch fmu build' in a checkout"
        )
        self.path = content.path
        root, self.variables, self._library = open_fmu(content)
        self.time_s = 0.0
        self._message = ""
        self._log = _LOG(self._take_message)
        self._instance = self._instantiate(root.get("instantiationToken", ""))
        self._flags = tuple(ctypes.byref(ctypes.c_bool()) for _ in range(3))
        self._reached_s = ctypes.c_double()
        self._initializing = False
        self._enter_initialization()

    def _instantiate(self, token: str) -> ctypes.c_void_p:
        instantiate = self._library.fmi3InstantiateCoSimulation
        instantiate.restype = ctypes.c_void_p
        instance = instantiate(
            self.path.stem.encode(), token.encode(), None,
            ctypes.c_bool(False), ctypes.c_bool(True), ctypes.c_bool(False), ctypes.c_bool(False),
            None, ctypes.c_size_t(0), None, self._log, None,
        )  # fmt: skip
        if not instance:
            raise InputError(
                self.path, f"refuses to start ({self._message})", "build the FMU again"
            )
        return ctypes.c_void_p(instance)

    def _take_message(self, _: Any, __: int, ___: bytes, message: bytes) -> None:
        self._message = message.decode(errors="replace")

    def _enter_initialization(self) -> None:
        no, zero = ctypes.c_bool(False), ctypes.c_double(0.0)
        self.call("fmi3EnterInitializationMode", no, zero, zero, no, zero)
        self._initializing = True
        self.time_s = 0.0

    def call(self, name: str, *arguments: Any) -> None:
        if getattr(self._library, name)(self._instance, *arguments) > _FMI_WARNING:
            raise FmuRefusal(f"{self.path}: {self._message or name + ' failed.'}")

    def variable(self, name: str, kind: str | None = None) -> InstanceVariable:
        variable = self.variables.get(name)
        if variable is None or kind not in (None, variable.type):
            what = f"has no variable {name}" if variable is None else f"{name} is no {kind}"
            raise InputError(
                self.path, what, "its variables are: " + ", ".join(self.variables)
            ) from None
        return variable

    def channel(self, names: Sequence[str]) -> Channel:
        return Channel(self, names)

    def tick_channel(self, inputs: Sequence[str], outputs: Sequence[str]) -> TickChannel:
        return TickChannel(self, inputs, outputs)

    def set(self, names: Sequence[str], values: ArrayLike) -> None:
        """Set variables by name to values of shape (n,)."""
        channel = self.channel(names)
        channel.values[:] = values
        channel.send()

    def get(self, names: Sequence[str]) -> Array:
        """Return the values of variables by name in SI units, shape (n,); a Boolean is 1 or 0."""
        return np.array([self._get(self.variable(name)) for name in names])

    def _get(self, variable: InstanceVariable) -> float:
        one, reference = ctypes.c_size_t(1), ctypes.c_uint32(variable.reference)
        if variable.type == "Boolean":
            truth = ctypes.c_bool()
            self.call("fmi3GetBoolean", ctypes.byref(reference), one, ctypes.byref(truth), one)
            return float(truth.value)
        value = ctypes.c_double()
        self.call("fmi3GetFloat64", ctypes.byref(reference), one, ctypes.byref(value), one)
        return value.value

    def start(self) -> None:
        """End the initialization mode: the first state follows from the values set so far."""
        self.call("fmi3ExitInitializationMode")
        self._initializing = False

    def step(self, step_s: float) -> None:
        if self._initializing:
            self.start()
        self.call(
            "fmi3DoStep", ctypes.c_double(self.time_s), ctypes.c_double(step_s),
            ctypes.c_bool(True), *self._flags, ctypes.byref(self._reached_s),
        )  # fmt: skip
        self.time_s = self._reached_s.value

    @property
    def ticks(self) -> bool:
        return hasattr(self._library, _TICK)

    def tick(self, step_s: float, arguments: Sequence[Any]) -> None:
        """Run a tick in one call; see `TickChannel`."""
        self.call(_TICK, *arguments)
        if step_s > 0.0:
            self._initializing = False
            self.time_s += step_s

    def reset(self) -> None:
        """Restart: start values, time zero, initialization mode."""
        self.call("fmi3Reset")
        self._enter_initialization()

    def close(self) -> None:
        """Free the instance; it cannot be used afterwards."""
        if self._instance:
            self._library.fmi3FreeInstance(self._instance)
            self._instance = ctypes.c_void_p()

    def __enter__(self) -> FmuInstance:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
