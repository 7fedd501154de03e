"""House rules: sizes, unique names, module docstrings and the words of the glossary."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

from tests.durations import LIST
from tests.house.each_file import ROOT, each_file, place, tree_of

ROOMS = ("firmware_py", "models", "fmu", "hil")
SOURCE = [
    p for room in (*ROOMS, "dropstitch", "bench") for p in sorted((ROOT / room).rglob("*.py"))
]
TESTS = sorted((ROOT / "tests").rglob("*.py"))
CODE = sorted(
    p for room in ROOMS for p in (ROOT / room).rglob("*") if p.suffix in (".c", ".h", ".html")
)

MAX_SOURCE, MAX_TEST, MAX_FUNCTION, MAX_FOLDER = 350, 400, 60, 13
LONG = "Long because"
"""What the docstring of a longer function says, followed by the reason."""

REPEATED_FILES = {"__init__", "__main__", "conftest"}
REPEATED_FUNCTIONS = {"main", "configure", "run"}

# Words of the glossary that were replaced, and what replaced them.
REPLACED = {
    "knob": "parameter", "knobs": "parameters", "laboratory": "rig", "testimony": "servo log",
    "surprise": "innovation", "surprises": "innovations", "namer": "effect search",
    "strained": "nuisance bias", "constancy": "strength consistency", "reality": "rig",
    "share": "fraction", "shares": "fractions", "spread": "standard deviation",
    "wire": "line or transport", "witness": "probe",
}  # fmt: skip
ARTICLES = {"a", "an", "the", "one", "every", "all", "what", "how", "its"}
QUESTIONS = {"what", "how", "where", "whether", "which", "who", "when", "why"}
VERBS = {
    "add", "ask", "build", "bring", "calculate", "call", "check", "choose", "compare", "compute",
    "convert", "create", "describe", "do", "draw", "emulate", "export", "find", "generate",
    "get", "give", "hold", "import", "inject", "install", "join", "judge", "keep", "learn", "let",
    "load", "look", "make", "measure", "name", "open", "play", "predict", "print", "put", "read",
    "refit", "release", "replay", "run", "say", "see", "send", "show", "simulate", "take",
    "tell", "test", "train", "turn", "use", "validate", "write",
}  # fmt: skip


def functions(tree: ast.AST) -> list[ast.FunctionDef]:
    return [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]


def repeated(names: list[tuple[str, str]]) -> dict[str, list[str]]:
    """Names that stand in more than one place, with the places."""
    counts = Counter(name for name, _ in names)
    return {n: [p for m, p in names if m == n] for n, count in counts.items() if count > 1}


def test_no_file_is_longer_than_the_house_allows():
    sizes = [(p, MAX_TEST if p in TESTS else MAX_SOURCE) for p in (*SOURCE, *TESTS, *CODE)]
    long = {place(p): n for p, most in sizes if (n := len(p.read_text().splitlines())) > most}
    assert not long


def test_no_function_is_longer_than_the_house_allows_without_a_reason():
    long = {
        f"{place(p)}:{f.name}": f.end_lineno - f.lineno + 1
        for p in (*SOURCE, *TESTS)
        for f in functions(tree_of(p))
        if f.end_lineno - f.lineno + 1 > MAX_FUNCTION and LONG not in (ast.get_docstring(f) or "")
    }
    assert not long


def test_no_folder_holds_more_files_than_can_be_overlooked():
    files = [p for room in (*ROOMS, "bench", "docs", "tests") for p in (ROOT / room).rglob("*.*")]
    kept = [p for p in files if p.is_file() and "__pycache__" not in p.parts]
    counts = Counter(place(p.parent) for p in kept if p.stem not in REPEATED_FILES)
    assert not {folder: n for folder, n in counts.items() if n > MAX_FOLDER}


def test_every_module_has_a_name_of_its_own():
    names = [(p.stem, place(p)) for p in (*SOURCE, *TESTS) if "commands" not in p.parts]
    assert not repeated([n for n in names if n[0] not in REPEATED_FILES])


def test_every_class_and_public_function_has_a_name_of_its_own():
    classes, public = [], []
    for path in SOURCE:
        for node in tree_of(path).body:
            if isinstance(node, ast.ClassDef):
                classes.append((node.name, place(path)))
            elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                public.append((node.name, place(path)))
    assert not repeated(classes)
    assert not repeated([n for n in public if n[0] not in REPEATED_FUNCTIONS])


@each_file(SOURCE)
def test_a_module_says_in_a_noun_phrase_what_it_holds(path):
    if not path.read_text(encoding="utf-8").strip():
        return  # an empty __init__.py
    docstring = ast.get_docstring(tree_of(path)) or ""
    first, second, *_ = [*re.split(r"[\s,:;.]+", docstring.strip(), maxsplit=2), "", ""]
    assert first, "no docstring"
    # "Export of …" and "Run in …" are nouns.
    forbidden = QUESTIONS if second in ("of", "in", "on") else QUESTIONS | VERBS
    assert first.lower() not in forbidden, docstring.splitlines()[0]
    assert first.lower() not in ("fit", "report") or second not in ARTICLES


def identifiers(tree: ast.Module) -> set[str]:
    """Names of classes, functions, arguments and module constants."""
    found = {n.name for n in ast.walk(tree) if isinstance(n, ast.ClassDef)}
    for function in functions(tree):
        arguments = function.args
        found |= {a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)}
        found.add(function.name)
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        found |= {t.id for t in targets if isinstance(t, ast.Name)}
    return found


def words(name: str) -> set[str]:
    return {w.lower() for w in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


@each_file(SOURCE)
def test_names_use_the_words_of_the_glossary(path):
    names = identifiers(tree_of(path)) | {path.stem}
    wrong = {n: REPLACED[w] for n in names for w in words(n) & REPLACED.keys()}
    assert not wrong


@each_file([p for p in SOURCE if p.parts[-2] != "bench"])
def test_production_code_raises_errors_in_place_of_asserting(path):
    asserts = [n.lineno for n in ast.walk(tree_of(path)) if isinstance(n, ast.Assert)]
    assert not asserts


PROSE = re.compile(
    r"\b(laborator(?:y|ies)|testimon(?:y|ies)|knobs?|namer)\b(?!\.json)", re.IGNORECASE
)


@each_file([*SOURCE, *TESTS, *CODE, *sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md"])
def test_texts_use_the_words_of_the_glossary(path):
    text = path.read_text(encoding="utf-8")
    assert path.name == Path(__file__).name or not PROSE.findall(text)


def is_fixture(function: ast.FunctionDef) -> bool:
    return any("fixture" in ast.unparse(decorator) for decorator in function.decorator_list)


def test_every_line_of_the_slow_list_names_a_test_or_a_fixture():
    """A line of another form, or of a test that was renamed, would mark nothing."""
    found = [f for path in TESTS for f in functions(tree_of(path))]
    names = {f.name for f in found if f.name.startswith("test_")}
    names |= {f"fixture:{f.name}" for f in found if is_fixture(f)}
    lines = LIST.read_text(encoding="utf-8").split()
    assert [line for line in lines if line not in names] == []
    assert lines == sorted(set(lines)), "as make test-durations writes it"
