"""Mutants of a source file: one comparison, operator, constant, condition or statement differs."""

from __future__ import annotations

import ast
import copy
import hashlib
import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

COMPARISONS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
}  # fmt: skip
FUNCTIONS = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all",
    "all": "any", "fmin": "fmax", "fmax": "fmin", "floor": "ceil", "ceil": "floor",
}  # fmt: skip
TALK = {"print", "warn", "isinstance", "issubclass"}
"""Calls that are left alone with all their arguments: messages, and types that are not numbers."""

LARGE = 1000
"""From here on an integer is a rate or a scale rather than a count, and is doubled."""

DELETED = (ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Expr, ast.Raise)


class Mutant(NamedTuple):
    path: Path
    line: int
    scope: str
    """Qualified name of the function or class within its module, "" at module level."""
    kind: str
    old: str
    new: str
    span: tuple[int, int]
    """Bytes of the source that are replaced."""
    key: str
    """The same while its function stays as it is, in whatever file."""

    def source(self) -> bytes:
        """The whole file with the mutant in place and every line where it was."""
        whole, (start, end) = self.path.read_bytes(), self.span
        lines = b"\n" * whole.count(b"\n", start, end)
        new = self.new.encode()
        if self.kind not in ("deletion", "return"):
            new = b"(" + new + lines + b")"
            lines = b""
        return whole[:start] + new + lines + whole[end:]


class _Change(NamedTuple):
    node: ast.AST
    kind: str
    new: str


def _with(node, **fields) -> str:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return ast.unparse(changed)


def _of_expression(node) -> Iterator[_Change]:
    if isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            ops = [*node.ops[:k], COMPARISONS[type(op)](), *node.ops[k + 1 :]]
            yield _Change(node, "comparison", _with(node, ops=ops))
    elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OPERATORS:
        yield _Change(node, "operator", _with(node, op=OPERATORS[type(node.op)]()))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield _Change(node, "operator", ast.unparse(node.operand))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield _Change(node, "constant", repr(not node.value))
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        for value in (node.value + 1, node.value - 1) if node.value < LARGE else (2 * node.value,):
            yield _Change(node, "constant", repr(value))
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield _Change(node, "constant", repr(2 * node.value or 1.0))
    elif isinstance(node, ast.Call):
        function = node.func
        if isinstance(function, ast.Name) and function.id in FUNCTIONS:
            yield _Change(function, "function", FUNCTIONS[function.id])
        elif isinstance(function, ast.Attribute) and function.attr in FUNCTIONS:
            yield _Change(function, "function", _with(function, attr=FUNCTIONS[function.attr]))


def _of_condition(test) -> Iterator[_Change]:
    same = isinstance(test, ast.Compare) and len(test.ops) == 1 and not isinstance(
        test.ops[0], ast.Lt | ast.LtE | ast.Gt | ast.GtE
    )  # fmt: skip
    if not same and not (isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)):
        yield _Change(test, "condition", f"not ({ast.unparse(test)})")


def _of_statement(node) -> Iterator[_Change]:
    if isinstance(node, ast.Return) and node.value is not None:
        if ast.unparse(node.value) != "None":
            yield _Change(node, "return", "return None")
    elif isinstance(node, DELETED):
        text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if not text and (not isinstance(node, ast.AnnAssign) or node.value is not None):
            yield _Change(node, "deletion", "pass")


def _left_alone(node) -> bool:
    """Whether it only talks, or names types."""
    if isinstance(node, ast.JoinedStr):
        return True
    if isinstance(node, ast.Call):
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        return name in TALK
    if isinstance(node, ast.BinOp):  # joined text
        sides = (node.left, node.right)
        return any(isinstance(s, ast.JoinedStr) or
                   (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in sides)  # fmt: skip
    if isinstance(node, ast.If):
        return any(word in ast.unparse(node.test) for word in ("TYPE_CHECKING", "__name__"))
    if isinstance(node, ast.AnnAssign):
        return "TypeAlias" in ast.unparse(node.annotation)
    return False


def _children(node) -> Iterator[ast.AST]:
    """Children without annotations, decorators, keywords of classes and messages of errors."""
    skipped = {
        ast.ClassDef: ("decorator_list", "keywords", "bases"),
        ast.FunctionDef: ("decorator_list", "returns"),
        ast.AsyncFunctionDef: ("decorator_list", "returns"),
        ast.AnnAssign: ("annotation",),
        ast.arg: ("annotation",),
        ast.Raise: ("exc", "cause"),
    }.get(type(node), ())
    for name, value in ast.iter_fields(node):
        if name not in skipped:
            values = value if isinstance(value, list) else [value]
            yield from (child for child in values if isinstance(child, ast.AST))


def _changes(node, scope: tuple[str, ...], function: bool) -> Iterator[tuple[str, _Change]]:
    if _left_alone(node):
        return
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        scope, function = (*scope, node.name), not isinstance(node, ast.ClassDef)
    found = [*_of_expression(node)]
    if function:
        found += _of_statement(node)
    for test in [getattr(node, "test", None), *getattr(node, "ifs", ())]:
        if test is not None and not isinstance(node, ast.Assert) and not _left_alone(test):
            found += _of_condition(test)
    for change in found:
        bits = isinstance(change.node, ast.BinOp) and isinstance(change.node.op, ast.BitOr)
        if function or not bits:  # outside functions `|` joins types
            yield ".".join(scope), change
    for child in _children(node):
        yield from _changes(child, scope, function)


def mutants(path: Path) -> list[Mutant]:
    """Every mutant of a file."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    seen, out = Counter(), []
    for scope, (node, kind, new) in _changes(ast.parse(source), (), False):
        old = ast.unparse(node)
        identity = (scope, kind, old, new)
        seen[identity] += 1
        text = "\0".join([*identity, str(seen[identity])])
        key = hashlib.sha256(text.encode()).hexdigest()[:12]
        start = starts[node.lineno - 1] + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        out.append(Mutant(path, node.lineno, scope, kind, old, new, (start, end), key))
    return out


def draw(paths: list[Path], count: int, seed: int) -> list[Mutant]:
    """`count` mutants of these files, of each kind about as many, first by their key and the seed.

    There are many more constants than comparisons, but comparisons decide.
    """

    def order(mutant):
        return hashlib.sha256(f"{seed} {mutant.key}".encode()).digest(), mutant.path

    of_kind: dict[str, list[Mutant]] = {}
    for mutant in sorted((m for path in paths for m in mutants(path)), key=order):
        of_kind.setdefault(mutant.kind, []).append(mutant)
    in_turn = sorted((k, order(m), m) for kind in of_kind.values() for k, m in enumerate(kind))
    return list(itertools.islice((m for *_, m in in_turn if _compiles(m)), count))


def _compiles(mutant: Mutant) -> bool:
    try:
        ast.parse(mutant.source())
    except SyntaxError:  # a sign in a pattern, for example
        return False
    return True
