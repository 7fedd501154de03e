"""Library of dropstitch: the names that programs and notebooks import.

They stand in `__init__.pyi`, once, which type checkers read as well. Each is loaded from its room
when it is first asked for, so that `import dropstitch` costs nothing (PEP 562, and SPEC 1 of
Scientific Python). The robot's wheel holds this package too: names of `firmware_py` work there,
those of the workshop say that it is missing. Whatever is not listed may change (docs/library.md).
"""

import functools
import importlib
from typing import Any

from firmware_py import __version__ as __version__


@functools.cache
def _modules() -> dict[str, str]:
    """Module of each name of the library; read when one is asked for: the command needs none."""
    import ast
    from pathlib import Path

    return {
        alias.name: str(node.module)
        for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def __getattr__(name: str) -> Any:
    """Load a name of the library from its room."""
    if name == "__all__":
        return ["__version__", *_modules()]
    module = _modules().get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
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
    """Names of the library."""
    return sorted(["__version__", *_modules()])
