"""CasADi function that reads and writes NumPy arrays in place.

A call takes some microseconds; passing the arrays as arguments takes ten times as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from models.shared.kinematics import Array


class InPlaceFunction:
    """A function bound to the arrays of its arguments and results.

    Arrays are contiguous float64; a CasADi matrix is stored by columns. Results must not share
    memory with arguments, because they are written while arguments are still read.
    """

    def __init__(
        self, function: ca.Function, arguments: Sequence[Array], results: Sequence[Array]
    ) -> None:
        sizes = [function.numel_in(k) for k in range(function.n_in())]
        sizes += [function.numel_out(k) for k in range(function.n_out())]
        if sizes != [array.size for array in (*arguments, *results)]:
            raise ValueError(f"{function.name()} has {sizes} elements")
        buffer: Any
        buffer, self._evaluate = function.buffer()
        for k, array in enumerate(arguments):
            buffer.set_arg(k, array.data)
        for k, array in enumerate(results):
            buffer.set_res(k, array.data)
        self._kept_alive = buffer, (*arguments, *results)

    def __call__(self) -> None:
        self._evaluate()
