"""Library of dropstitch: the names that programs and notebooks import.

`__init__.pyi` lists them once, also for type checkers. The first access to a name imports its room,
so that `import dropstitch` costs nothing (PEP 562, and SPEC 1 of Scientific Python). The robot's
wheel contains this package, too: there, names of `firmware_py` work, and those of the workshop
raise an ImportError. Names that are not listed may change (docs/library.md).
"""

import ast
import importlib
from pathlib import Path
from typing import Any, Final

from firmware_py import __version__

_MODULE_OF: Final = {
    alias.name: str(node.module)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}

__all__ = ["__version__", *_MODULE_OF]


def __getattr__(name: str) -> Any:
    """Import a name of the library from its room on first access."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _MODULE_OF[name]
    try:
        value = getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if module.startswith("firmware_py."):
            raise
        raise ImportError(
            f"dropstitch.{name} belongs to the workshop, and {error.name} is not installed here; "
            "use it in a checkout after 'make setup'."
        ) from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
