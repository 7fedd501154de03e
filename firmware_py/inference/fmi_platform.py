"""Name of this machine's platform, as FMI 3.0 writes it (section 2.5.1.4)."""

from __future__ import annotations

import platform
from typing import Final

_MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64"}
"""What systems call the processors in their own way; Windows in capitals."""


def platform_here() -> str:
    """Return the platform of this process, like "x86_64-linux" or "aarch64-darwin".

    Returns processor and system; one of those that an FMU may be built for, or another one.
    """
    machine = platform.machine().lower()
    return f"{_MACHINES.get(machine, machine)}-{platform.system().lower()}"
