"""Name of this machine's platform, as FMI 3.0 writes it (section 2.5.1.4)."""

from __future__ import annotations

import platform
from typing import Final

_MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64"}
"""FMI name of a processor by the operating system's name in lower case (Windows: capitals)."""


def platform_here() -> str:
    """Return processor and system of this process, like "x86_64-linux" or "aarch64-darwin"."""
    machine = platform.machine().lower()
    return f"{_MACHINES.get(machine, machine)}-{platform.system().lower()}"
