"""Every package that a room imports is declared where the room is installed from."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions

import pytest

from tests.house.sources import ROOT, python_files, tree_of

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = {
    "firmware_py": ("record", "live", "trust", "completion"),
    "dropstitch": ("library",),
    "models": ("workshop", "rod", "library"),
    "fmu": ("workshop",),
    "hil": ("workshop", "dask"),
}
"""Extras of the rooms, beside the dependencies of the robot."""
DISTRIBUTIONS = packages_distributions()


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def declared(requirements: list[str]) -> set[str]:
    """Names of requirements; our extras stand for what they contain."""
    names: set[str] = set()
    for text in requirements:
        name, extras = re.match(r"([\w.-]+)(?:\[([\w,]+)\])?", text).groups()
        if normalised(name) == PROJECT["name"]:
            for extra in extras.split(","):
                names |= declared(PROJECT["optional-dependencies"][extra])
        else:
            names.add(normalised(name))
    return names


def imported(path) -> set[str]:
    """Top packages that a file imports, wherever in it."""
    nodes = list(ast.walk(tree_of(path)))
    names = [a.name for n in nodes if isinstance(n, ast.Import) for a in n.names]
    names += [n.module for n in nodes if isinstance(n, ast.ImportFrom) and not n.level]
    return {name.partition(".")[0] for name in names} - EXTRAS.keys() - sys.stdlib_module_names


@pytest.mark.parametrize("room", EXTRAS)
def test_what_a_room_imports_is_declared(room):
    known = declared(PROJECT["dependencies"])
    for extra in EXTRAS[room]:
        known |= declared(PROJECT["optional-dependencies"][extra])
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in python_files(room)
        for name in imported(path)
        if known.isdisjoint(normalised(d) for d in DISTRIBUTIONS.get(name, [name]))
    }
    assert not missing, f"declare in pyproject.toml: {sorted(missing)}"
