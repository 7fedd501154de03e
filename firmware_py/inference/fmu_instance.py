"""Instance of an FMI 3.0 co-simulation FMU, called through ctypes: the observer of the bundle.

It supports scalars of type Float64 and Boolean and one instance per FMU. The loop uses a `Channel`,
whose buffers are allocated once; `set` and `get` by name serve all other purposes.
"""

from __future__ import annotations

import ctypes
import platform
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.errors import FmuRefusal, InputError

__all__ = ["Channel", "FmuInstance", "InstanceVariable"]

Array = NDArray[np.float64]

_MACHINES: Final = {"x86_64": "x86_64", "AMD64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_SYSTEMS: Final = {"Linux": ("linux", ".so"), "Darwin": ("darwin", ".dylib")}
_LOG = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
_FUNCTIONS: Final = (
    "fmi3InstantiateCoSimulation", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode",
    "fmi3SetFloat64", "fmi3GetFloat64", "fmi3GetBoolean", "fmi3DoStep", "fmi3Reset",
    "fmi3FreeInstance",
)  # fmt: skip
"""Functions of the standard that are called."""
_FMI_WARNING: Final = 1
"""A call has failed where its status is above this."""


class InstanceVariable(NamedTuple):
    """Scalar variable of an FMU, as its model description declares it.

    Attributes
    ----------
    name : str
        Name.
    reference : int
        Value reference.
    type : str
        Type, like "Float64".
    causality : str
        Causality, like "input".
    unit : str
        SI unit; "1" for none.
    start : float or None
        Start value of a Float64.
    """

    name: str
    reference: int
    type: str
    causality: str
    unit: str
    start: float | None


class Channel:
    """Fixed set of variables of an FMU, transferred together through one buffer.

    Parameters
    ----------
    fmu : FmuInstance
        The FMU.
    names : sequence of str
        Variables of type Float64.

    Attributes
    ----------
    values : ndarray, shape (n,)
        Values to write before `send`, and to read after `receive`; always the same memory.
    """

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
        """Set the variables to `values`."""
        self._fmu.call("fmi3SetFloat64", *self._arguments)

    def receive(self) -> None:
        """Read the variables into `values`."""
        self._fmu.call("fmi3GetFloat64", *self._arguments)


class FmuInstance:
    """Instance of an FMI 3.0 co-simulation FMU.

    It starts in initialization mode: values set then determine its first state. The first step, or
    `start`, ends this mode.

    Parameters
    ----------
    path : Path or str
        The .fmu file.

    Attributes
    ----------
    variables : dict of str to InstanceVariable
        By name, in the order of the file.
    time_s : float
        Time that the FMU has reached.

    Raises
    ------
    InputError
        If the file is missing or damaged, is of another FMI version or kind, or has no binary for
        this machine.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        root, self.variables, self._library = _open(self.path)
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
        """Call an FMI function on this instance.

        Parameters
        ----------
        name : str
            Name of the function.
        *arguments
            Arguments after the instance, as ctypes objects.

        Raises
        ------
        FmuRefusal
            If the call fails.
        """
        if getattr(self._library, name)(self._instance, *arguments) > _FMI_WARNING:
            raise FmuRefusal(f"{self.path}: {self._message or name + ' failed.'}")

    def variable(self, name: str, kind: str | None = None) -> InstanceVariable:
        """Return a variable.

        Parameters
        ----------
        name : str
            Name of the variable.
        kind : str, optional
            Type that it must have, like "Float64".

        Raises
        ------
        InputError
            If the FMU has no variable of this name and type.
        """
        found = self.variables.get(name)
        if found is None or kind not in (None, found.type):
            what = f"has no variable {name}" if found is None else f"{name} is no {kind}"
            raise InputError(
                self.path, what, "its variables are: " + ", ".join(self.variables)
            ) from None
        return found

    def channel(self, names: Sequence[str]) -> Channel:
        """Return a channel for variables that are transferred together."""
        return Channel(self, names)

    def set(self, names: Sequence[str], values: ArrayLike) -> None:
        """Set variables by name; `values` has the shape (n,)."""
        channel = self.channel(names)
        channel.values[:] = values
        channel.send()

    def get(self, names: Sequence[str]) -> Array:
        """Return the values of variables by name, shape (n,); a Boolean is 1 or 0."""
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
        """Advance by `step_s` with the inputs that are set."""
        if self._initializing:
            self.start()
        self.call(
            "fmi3DoStep", ctypes.c_double(self.time_s), ctypes.c_double(step_s),
            ctypes.c_bool(True), *self._flags, ctypes.byref(self._reached_s),
        )  # fmt: skip
        self.time_s = self._reached_s.value

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


def _open(path: Path) -> tuple[ET.Element, dict[str, InstanceVariable], ctypes.PyDLL]:
    """Read the model description with its variables, and load the binary for this machine."""
    remedy = "build it again with 'python -m fmu build' or copy it again"
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            astray = [n for n in names if PurePosixPath(n).is_absolute() or ".." in n.split("/")]
            if astray:
                raise InputError(
                    path, f"holds a file with a path outside the archive ({astray[0]})", remedy
                )
            root = ET.fromstring(archive.read("modelDescription.xml"))
            variables = {v.name: v for v in _variables(root)}
            name = _binary(path, root, names)
            binary = archive.read(name)
    except FileNotFoundError:
        raise InputError(path, "is missing", remedy) from None
    except (zipfile.BadZipFile, zlib.error, ET.ParseError, OSError, EOFError, KeyError,
            ValueError, RuntimeError) as error:  # fmt: skip
        raise InputError(path, f"is no FMU ({error})", remedy) from None
    with TemporaryDirectory(prefix="dropstitch-fmu-") as private:
        library = Path(private) / PurePosixPath(name).name
        library.write_bytes(binary)
        try:
            # PyDLL keeps the interpreter's lock: a step takes microseconds, and releasing the lock
            # could cost the loop's thread a switch interval to get it back.
            loaded = ctypes.PyDLL(str(library))  # stays mapped when the file is deleted
        except OSError as error:
            raise InputError(
                path, f"its binary does not load ({error})",
                "set TMPDIR to a directory from which programs may run, or build the FMU again",
            ) from None  # fmt: skip
    absent = [function for function in _FUNCTIONS if not hasattr(loaded, function)]
    if absent:
        raise InputError(path, f"its binary lacks {absent[0]}", remedy)
    return root, variables, loaded


def _binary(path: Path, root: ET.Element, names: Iterable[str]) -> str:
    """Return the name of the binary for this machine inside the archive."""
    version = root.get("fmiVersion", "?")
    if not version.startswith("3."):
        raise InputError(path, f"is of FMI {version}", "build it with --fmi 3")
    simulation = root.find("CoSimulation")
    if simulation is None:
        raise InputError(path, "is not for Co-Simulation", "build it with 'python -m fmu build'")
    system, suffix = _SYSTEMS.get(platform.system(), (platform.system().lower(), ".dll"))
    here = f"{_MACHINES.get(platform.machine(), platform.machine())}-{system}"
    name = f"binaries/{here}/{simulation.get('modelIdentifier')}{suffix}"
    if name not in names:
        offered = sorted({n.split("/")[1] for n in names if n.startswith("binaries/")})
        raise InputError(
            path, f"holds no binary for {here}, only for {', '.join(offered) or 'none'}",
            "build the FMU for this platform",
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
