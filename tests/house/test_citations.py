"""Citations: every path, section, module and link that a text names is there."""

from __future__ import annotations

import ast
import functools
import io
import re
import tokenize
from pathlib import Path

import pytest

from tests.house.each_file import ROOT, each_file, tree_of

ROOMS = ("firmware_py", "models", "fmu", "hil", "dropstitch", "bench", "tests")
MARKDOWN = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
PYTHON = [
    *sorted(ROOT.glob("*.py")),
    *(p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))),
]
DATA = [
    *sorted(ROOT.glob("*.toml")), ROOT / "Makefile",
    *sorted((ROOT / "docs").glob("*.toml")),
    *(p for ext in ("*.toml", "*.json", "*.c", "*.h", "*.html")
      for room in ROOMS for p in sorted((ROOT / room).rglob(ext)) if "__pycache__" not in p.parts),
]  # fmt: skip
OUTSIDE = (*(word.upper() for word in ("facts", "design")), "data " + "README")
"""Documents that are not in the repository."""

SECTION = re.compile(r'(docs/[\w-]+\.md), "([^"]+)"')
FILE = re.compile(
    r"(?<![\w/.-])((?:firmware_py|models|fmu|hil|dropstitch|bench|tests|docs|requirements)/[\w./-]*\w)"
    r"(?=[\s`'\",.;:)\]]|$)"
)
DOTTED = re.compile(r"`((?:firmware_py|models|fmu|hil|bench)(?:\.\w+)+)(?:\(\))?`")
COMMAND = re.compile(r"python -m ((?:firmware_py|models|fmu|hil|bench|tests)[\w.]*\w)")
LINK = re.compile(r"\]\(([^)\s]+)\)")


@functools.cache
def prose(path: Path) -> str:
    """Text that a person reads, in one line: the whole file, or docstrings and comments of code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        comments = [t.string.lstrip("#") for t in tokens if t.type == tokenize.COMMENT]
        strings = [
            node.value.value
            for node in ast.walk(tree_of(path))
            if isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ]
        text = "\n".join([*strings, *comments])
    elif path.suffix in (".toml", ".c", ".h"):
        text = re.sub(r"\n\s*(#|\*|//)", "\n", text)
    return re.sub(r"\s+", " ", text.replace('\\"', '"'))


@functools.cache
def headings(path: Path) -> list[str]:
    return re.findall(r"^#+ (.+?)\s*$", path.read_text(encoding="utf-8"), re.MULTILINE)


def anchor(heading: str) -> str:
    """Fragment of a heading as code hosts form it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def module_file(dotted: list[str]) -> Path | None:
    base = ROOT.joinpath(*dotted)
    return next((p for p in (base.with_suffix(".py"), base / "__init__.py") if p.is_file()), None)


def exists(dotted: str) -> bool:
    """Whether a dotted name leads to a module, or to a name that stands in one."""
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        file = module_file(parts[:length])
        if file is None and length == len(parts) and ROOT.joinpath(*parts).is_dir():
            return True
        if file is not None:
            source, rest = file.read_text(encoding="utf-8"), parts[length:]
            return all(re.search(rf"\b{re.escape(name)}\b", source) for name in rest)
    return False


@each_file([*MARKDOWN, *PYTHON, *DATA])
def test_nothing_cites_a_document_outside_the_repository(path):
    text = path.read_text(encoding="utf-8")
    assert not re.findall(rf"\b(?:{'|'.join(OUTSIDE)})\b", text)


@pytest.mark.slow
@each_file([*MARKDOWN, *PYTHON, *DATA])
def test_cited_sections_and_files_are_there(path):
    text = prose(path)
    for document, section in SECTION.findall(text):
        file = ROOT / document
        assert file.is_file(), document
        if section != "Section title":
            assert section in headings(file), f'{document} has no section "{section}"'
    for name in FILE.findall(text):
        if "." in name.rsplit("/", 1)[1] and not name.endswith("."):
            assert (ROOT / name).exists(), name


@each_file([*MARKDOWN, *PYTHON])
def test_named_modules_and_commands_are_there(path):
    text = prose(path)
    assert not [name for name in DOTTED.findall(text) if not exists(name)]
    for name in COMMAND.findall(text):
        parts = name.split(".")
        assert ROOT.joinpath(*parts, "__main__.py").is_file() or module_file(parts), name


@each_file(MARKDOWN)
def test_links_lead_somewhere(path):
    for link in LINK.findall(path.read_text(encoding="utf-8")):
        target, _, fragment = link.partition("#")
        if "://" in target:
            continue
        file = path.parent / target if target else path
        assert file.exists(), link
        if fragment:
            assert fragment in {anchor(h) for h in headings(file)}, link


def test_a_citation_that_does_not_resolve_is_seen():
    """The helpers themselves, on names that are not there."""
    assert SECTION.findall('(docs/sources.md, "No such thing")')
    assert "No such thing" not in headings(ROOT / "docs/sources.md")
    assert FILE.findall("see `models/plant/no_such.py`.") == ["models/plant/no_such.py"]
    assert exists("models.plant.plant.Plant") and exists("firmware_py.bus")
    assert not exists("models.plant.no_such.Plant") and not exists("models.plant.plant.NoSuch")
