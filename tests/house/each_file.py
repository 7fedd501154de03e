"""Syntax trees of the sources, and a decorator that runs a test over many files.

The decorator makes one test per room, so that the report stays short.
"""

from __future__ import annotations

import ast
import functools
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Syntax tree of a source; each file is parsed once in a session."""
    return ast.parse(path.read_text(encoding="utf-8"))


def each_file(paths: Iterable[Path]) -> Callable[[Callable[[Path], None]], Callable[[str], None]]:
    """Make of a test of one file a test of every room's files; a failure names each file."""
    rooms: dict[str, list[Path]] = defaultdict(list)
    for path in paths:
        parts = path.relative_to(ROOT).parts
        rooms[parts[0] if len(parts) > 1 else "root"].append(path)

    def over_rooms(test: Callable[[Path], None]) -> Callable[[str], None]:
        @pytest.mark.parametrize("room", sorted(rooms))
        def test_room(room: str) -> None:
            failures = []
            for path in rooms[room]:
                try:
                    test(path)
                except AssertionError as error:
                    failures.append(f"{path.relative_to(ROOT)}: {error}")
            assert not failures, "\n".join(failures)

        test_room.__name__, test_room.__doc__ = test.__name__, test.__doc__
        return test_room

    return over_rooms
