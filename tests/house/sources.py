"""Sources of the project, and their syntax trees."""

import ast
import functools
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("firmware_py", "models", "fmu", "hil", "dropstitch")


def python_files(*rooms: str) -> list[Path]:
    return [path for room in rooms for path in sorted((ROOT / room).rglob("*.py"))]


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Syntax tree of a source; each file is parsed once in a session."""
    return ast.parse(path.read_text(encoding="utf-8"))
