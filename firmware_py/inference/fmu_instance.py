"""Instance of an FMI 3.0 co-simulation FMU, called through ctypes: the observer of the bundle.

It supports scalars of type Float64 and Boolean and one instance per FMU. The loop uses a `Channel`,
whose buffers are allocated once; everything else uses `set` and `get` by name.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.inference.file_content import Source, content_of
from firmware_py.inference.fmu_file import InstanceVariable, open_fmu

__all__ = ["Channel", "FmuInstance", "TickChannel"]

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
        """Set the variables to `values`."""
        self._fmu.call("fmi3SetFloat64", *self._arguments)

    def receive(self) -> None:
        """Read the variables into `values`."""
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
        """Set the inputs, step, get the outputs."""
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
        """Call an FMI function on this instance."""
        if getattr(self._library, name)(self._instance, *arguments) > _FMI_WARNING:
            raise FmuRefusal(f"{self.path}: {self._message or name + ' failed.'}")

    def variable(self, name: str, kind: str | None = None) -> InstanceVariable:
        found = self.variables.get(name)
        if found is None or kind not in (None, found.type):
            what = f"has no variable {name}" if found is None else f"{name} is no {kind}"
            raise InputError(
                self.path, what, "its variables are: " + ", ".join(self.variables)
            ) from None
        return found

    def channel(self, names: Sequence[str]) -> Channel:
        """Return a channel for variables of type Float64 that are transferred together."""
        return Channel(self, names)

    def tick_channel(self, inputs: Sequence[str], outputs: Sequence[str]) -> TickChannel:
        """Return a channel that runs a tick in one call."""
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
        """Advance with the inputs that are set."""
        if self._initializing:
            self.start()
        self.call(
            "fmi3DoStep", ctypes.c_double(self.time_s), ctypes.c_double(step_s),
            ctypes.c_bool(True), *self._flags, ctypes.byref(self._reached_s),
        )  # fmt: skip
        self.time_s = self._reached_s.value

    @property
    def ticks(self) -> bool:
        """Whether the binary can run a tick in one call."""
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
