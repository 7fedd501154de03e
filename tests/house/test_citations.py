"""Citations: every path, section, module and link that a text names is there."""

import ast
import functools
import io
import re
import tokenize
from pathlib import Path

import pytest

from tests.house.sources import ROOMS, ROOT, python_files, tree_of

FOLDERS = (*ROOMS, "bench", "tests")
MARKDOWN = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
PYTHON = [*sorted(ROOT.glob("*.py")), *python_files(*FOLDERS)]
DATA = [
    *sorted(ROOT.glob("*.toml")), ROOT / "Makefile",
    *(p for ext in ("*.toml", "*.c", "*.h", "*.html")
      for folder in FOLDERS for p in sorted((ROOT / folder).rglob(ext))),
]  # fmt: skip

SECTION = re.compile(r'(docs/[\w-]+\.md), "([^"]+)"')
FILE = re.compile(
    r"(?<![\w/.-])((?:firmware_py|models|fmu|hil|dropstitch|bench|tests|docs|requirements)/[\w./-]*\w)"
    r"(?=[\s`'\",.;:)\]]|$)"
)
DOTTED = re.compile(r"`((?:firmware_py|models|fmu|hil|bench)(?:\.\w+)+)(?:\(\))?`")
COMMAND = re.compile(r"python -m ((?:firmware_py|models|fmu|hil|bench|tests)[\w.]*\w)")
LINK = re.compile(r"\]\(([^)\s]+)\)|^\[[^\]]+\]: (\S+)$", re.MULTILINE)
"""Links of a page: in the text, or defined at its end."""
HOSTED = re.compile(
    r"https://(?:github\.com/OWNER/dropstitch/blob|raw\.githubusercontent\.com/OWNER/dropstitch)/main/"
)
"""Begin of an absolute link to a file of this repository, which a package index needs."""


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


@pytest.mark.slow
def test_cited_sections_files_modules_and_commands_are_there():
    missing = []
    for path in [*MARKDOWN, *PYTHON, *DATA]:
        text = prose(path)
        for document, section in SECTION.findall(text):
            if section != "Section title" and section not in headings(ROOT / document):
                missing.append((path, document, section))
        for name in FILE.findall(text):
            if "." in name.rsplit("/", 1)[1] and not (ROOT / name).exists():
                missing.append((path, name))
        if path.suffix in (".py", ".md"):
            missing += [(path, name) for name in DOTTED.findall(text) if not exists(name)]
            for name in COMMAND.findall(text):
                parts = name.split(".")
                if not (ROOT.joinpath(*parts, "__main__.py").is_file() or module_file(parts)):
                    missing.append((path, name))
    assert not missing


def test_links_lead_somewhere():
    broken = []
    for path in MARKDOWN:
        for link in map("".join, LINK.findall(path.read_text(encoding="utf-8"))):
            target, _, fragment = HOSTED.sub("/", link).partition("#")
            if "://" in target:
                continue
            file = path.parent / target if target else path
            if target.startswith("/"):
                file = ROOT / target[1:]
            if not file.exists() or (fragment and fragment not in map(anchor, headings(file))):
                broken.append((path, link))
    assert not broken
