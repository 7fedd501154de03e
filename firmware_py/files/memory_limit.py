"""Limit of the memory that reading a file may take, in this process or for good in a child."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_py.display_units import DATA_SIZE
from firmware_py.errors import InputError

__all__ = ["MEMORY_BYTES", "limit_memory", "limited_memory"]

MEMORY_BYTES: Final = 350_000_000
"""Memory that reading a file may take beyond what is taken before: an importer has 100 MB of
libraries loaded and stays below 500 MB."""


def limit_memory(memory_bytes: int = MEMORY_BYTES) -> tuple[int, int] | None:
    """Limit the address space of this process to what it has and some more.

    Returns the limits before, soft and hard; None where the system has no such limit (not Linux).
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
    """Refuse a file for which the code within needs more memory than it may.

    `memory_bytes`: memory that the code may take beyond what is taken now.
    """
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
