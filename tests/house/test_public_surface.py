"""Public surface: the names that modules export are the names that the architecture lists."""

from __future__ import annotations

import ast
import importlib
import re

import pytest

from tests.house.each_file import ROOT, tree_of

PAGE = ROOT / "docs" / "architecture.md"
ROOMS = ("firmware_py", "models", "fmu", "hil")


def listed() -> dict[str, set[str]]:
    """Module to names, as the table of the page has them."""
    section = PAGE.read_text(encoding="utf-8").split("\n## Public surface\n")[1]
    rows = re.findall(r"^\| `([\w.]+)` \| (.+) \|$", section, re.MULTILINE)
    return {module: set(re.findall(r"`(\w+)`", names)) for module, names in rows}


def exporting() -> dict[str, set[str]]:
    """Module to the names of its `__all__`, found in the sources."""
    found = {}
    for path in (p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))):
        for node in tree_of(path).body:
            targets = getattr(node, "targets", [getattr(node, "target", None)])
            if any(isinstance(t, ast.Name) and t.id == "__all__" for t in targets):
                parts = path.relative_to(ROOT).with_suffix("").parts
                name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
                found[name] = set(ast.literal_eval(node.value))
    return found


def row(module: str, names: set[str]) -> str:
    """A row of the table, for a module that it does not list rightly."""
    return f"| `{module}` | {', '.join(f'`{n}`' for n in sorted(names))} |"


def test_the_page_lists_what_the_modules_export():
    code, page = exporting(), listed()
    wrong = sorted(m for m in code.keys() | page.keys() if code.get(m) != page.get(m))
    rows = "\n".join(row(m, code[m]) if m in code else f"not there: {m}" for m in wrong)
    assert not wrong, f"docs/architecture.md, Public surface:\n{rows}"


@pytest.mark.parametrize("module", sorted(listed()))
def test_every_exported_name_is_there_and_explained(module):
    loaded = importlib.import_module(module)
    for name in sorted(listed()[module]):
        value = getattr(loaded, name)
        if callable(value) and getattr(value, "__module__", "").split(".")[0] in ROOMS:
            assert (value.__doc__ or "").strip(), f"{module}.{name} has no docstring"
