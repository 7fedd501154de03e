"""Limit of the memory for reading a file, temporarily in this process or for good in a child."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.core.errors import InputError
from firmware_py.core.units import DATA_SIZE

__all__ = ["MEMORY_BYTES", "limit_memory", "limited_memory"]

MEMORY_BYTES: Final = 350_000_000
"""Additional memory for reading a file: an importer with 100 MB of loaded libraries stays below
500 MB."""


def limit_memory(memory_bytes: int = MEMORY_BYTES) -> tuple[int, int] | None:
    """Limit the address space of this process to its present size and `memory_bytes` more.

    Returns the previous soft and hard limits; None on systems without such a limit (not Linux).
    """
    if sys.platform != "linux":
        return None
    import resource

    statm = Path("/proc/self/statm").read_text(encoding="ascii")
    most = int(statm.split()[0]) * resource.getpagesize() + memory_bytes
    before = resource.getrlimit(resource.RLIMIT_AS)
    known = [limit for limit in before if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([most, *known]), before[1]))
    return before


@contextlib.contextmanager
def limited_memory(
    where: Path | str, remedy: str, memory_bytes: int = MEMORY_BYTES
) -> Iterator[None]:
    """Refuse a file if the code of the block needs more than `memory_bytes` of new memory."""
    before = limit_memory(memory_bytes)
    try:
        yield
    except MemoryError:
        what = f"takes more than {DATA_SIZE.number(memory_bytes)} MB to read"
        raise InputError(where, what, remedy) from None
    finally:
        if before is not None:
            import resource

            resource.setrlimit(resource.RLIMIT_AS, before)
