"""Mutants of a source file: one comparison, operator, constant, condition or statement differs.

Python files are mutated in their syntax tree, C files by regular expressions over their lines.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import itertools
import re
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
"""Calls that are left alone with their arguments: messages, and types."""

LARGE = 1000
"""From here on an integer is a rate or a scale rather than a count, and is doubled."""

SKIPPED = {
    ast.ClassDef: ("decorator_list", "keywords", "bases"),
    ast.FunctionDef: ("decorator_list", "returns"),
    ast.AnnAssign: ("annotation",),
    ast.arg: ("annotation",),
    ast.Raise: ("exc", "cause"),
}
"""Parts of nodes that are no decisions: types, options of classes, messages of errors."""


class Mutant(NamedTuple):
    path: Path
    line: int
    kind: str
    old: str
    new: str
    span: tuple[int, int]
    """Bytes of the source that are replaced."""
    key: str
    """The same while its function (in C its line) stays as it is, in whatever file."""

    def source(self) -> bytes:
        """The whole file with the mutant in place and every line where it was."""
        whole, (start, end) = self.path.read_bytes(), self.span
        new = self.new.encode() + b"\n" * whole.count(b"\n", start, end)
        if self.path.suffix == ".py" and self.kind not in ("deletion", "return"):
            new = b"(" + new + b")"
        return whole[:start] + new + whole[end:]


def _with(node, **fields) -> str:
    changed = copy.copy(node)
    vars(changed).update(fields)
    return ast.unparse(changed)


def _changes(node, function: bool) -> Iterator[tuple[ast.AST, str, str]]:
    """What is replaced, kind of the mutant, new text; `function` is whether it is part of one."""
    match node:
        case ast.Compare(ops=ops):
            for k, op in enumerate(ops):
                other = [*ops[:k], COMPARISONS[type(op)](), *ops[k + 1 :]]
                yield node, "comparison", _with(node, ops=other)
        case ast.BinOp(op=ast.BitOr()) if not function:  # it joins types
            pass
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in OPERATORS:
            yield node, "operator", _with(node, op=OPERATORS[type(op)]())
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield node, "operator", ast.unparse(operand)
        case ast.Constant(value=bool(value)):
            yield node, "constant", repr(not value)
        case ast.Constant(value=int(value)):
            for other in (value + 1, value - 1) if value < LARGE else (2 * value,):
                yield node, "constant", repr(other)
        case ast.Constant(value=float(value)):
            yield node, "constant", repr(2 * value or 1.0)
        case ast.Call(func=ast.Name(id=name) as called) if name in FUNCTIONS:
            yield called, "function", FUNCTIONS[name]
        case ast.Call(func=ast.Attribute(attr=name) as called) if name in FUNCTIONS:
            yield called, "function", _with(called, attr=FUNCTIONS[name])
        case ast.Return(value=None | ast.Constant(value=None | False | "")):
            pass  # to most callers the same as None
        case ast.Return():
            yield node, "return", "return None"
        case ast.Expr(value=ast.Constant()) | ast.AnnAssign(value=None):
            pass  # a docstring, a declaration
        case ast.Assign() | ast.AugAssign() | ast.AnnAssign() | ast.Expr() | ast.Raise():
            if function:  # a module without one of its names is no test of a test
                yield node, "deletion", "pass"
    tests = [] if isinstance(node, ast.Assert) else [getattr(node, "test", None)]
    for test in filter(None, [*tests, *getattr(node, "ifs", ())]):
        match test:
            case ast.UnaryOp(op=ast.Not()):
                pass  # negated as an operator
            case ast.Compare(ops=[ast.Eq() | ast.NotEq() | ast.Is() | ast.IsNot()]):
                pass  # and these as a comparison
            case ast.Compare(ops=[ast.In() | ast.NotIn()]):
                pass
            case _ if not _left_alone(test):
                yield test, "condition", f"not ({ast.unparse(test)})"


def _left_alone(node) -> bool:
    """Whether it only talks, or names types."""
    match node:
        case ast.JoinedStr():
            return True
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name in TALK
        case ast.BinOp():  # joined text
            text = ast.JoinedStr | ast.Constant
            sides = [side for side in (node.left, node.right) if isinstance(side, text)]
            return any(isinstance(getattr(side, "value", ""), str) for side in sides)
        case ast.If():
            return any(word in ast.unparse(node.test) for word in ("TYPE_CHECKING", "__name__"))
        case ast.AnnAssign():
            return "TypeAlias" in ast.unparse(node.annotation)
    return False


def _walk(node, scope: str, function: bool) -> Iterator[tuple[str, ast.AST, str, str]]:
    if _left_alone(node):
        return
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        scope, function = f"{scope}.{node.name}", isinstance(node, ast.FunctionDef)
    yield from ((scope, *change) for change in _changes(node, function))
    for name, value in ast.iter_fields(node):
        if name not in SKIPPED.get(type(node), ()):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _walk(child, scope, function)


def mutants(path: Path) -> list[Mutant]:
    """Every mutant of a file."""
    found = _python_mutants(path) if path.suffix == ".py" else _c_mutants(path)
    count, out = Counter(), []
    for line, kind, old, new, span, scope in found:
        identity = (scope, kind, old, new)
        count[identity] += 1
        key = hashlib.sha256("\0".join([*identity, str(count[identity])]).encode()).hexdigest()[:12]
        out.append(Mutant(path, line, kind, old, new, span, key))
    return out


Found = tuple[int, str, str, str, tuple[int, int], str]
"""Line, kind, old and new text, span of bytes, and what the key follows from beside them."""


def _python_mutants(path: Path) -> Iterator[Found]:
    source = path.read_bytes()
    starts = [0, *itertools.accumulate(map(len, source.splitlines(keepends=True)))]
    for scope, node, kind, new in _walk(ast.parse(source), "", False):
        span = (starts[node.lineno - 1] + node.col_offset,
                starts[node.end_lineno - 1] + node.end_col_offset)  # fmt: skip
        yield node.lineno, kind, ast.unparse(node), new, span, scope.lstrip(".")


C_REPLACED = {
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==",
    "+": "-", "-": "+", "*": "/", "/": "*", "&&": "||", "||": "&&", "&": "|", "|": "&",
    "+=": "-=", "-=": "+=",
}  # fmt: skip
C_OPERATOR = re.compile(r"(?<= )(<=?|>=?|[!=]=|[-+]=?|[*/]|&&?|\|\|?)(?= )")
C_NOT = re.compile(r"!(?=[\w(])")
C_NUMBER = re.compile(r"(?<![\w.])(\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)(?![\w.])")
C_CONDITION = re.compile(r"\bif \((.*)\)(?= \{$|$)")
C_STATEMENT = re.compile(r"^ +(?! |return|break|goto|else|case|default|do\b)[^{}]*;$")
C_DECLARATION = re.compile(
    r"^ +(?:static |const |unsigned )*[A-Za-z_]\w* \**\w+(?:\[.*\])?(?: =|,|;)"
)
C_TALK = re.compile(r'"(?:[^"\\]|\\.)*"|/\*.*?\*/|/\*.*|#.*')
"""Text, comments and directives, which are left alone."""


def _c_mutants(path: Path) -> Iterator[Found]:
    """Mutants of C lines; those that do not compile are noticed when they are run."""
    start, comment = 0, False
    for number, raw in enumerate(path.read_text(encoding="utf-8").splitlines(keepends=True), 1):
        line = C_TALK.sub(lambda found: " " * len(found[0]), raw.rstrip("\n"))
        if comment:
            comment, line = "*/" not in raw, ""
        comment = comment or raw.rfind("/*") > raw.rfind("*/")
        for kind, span, new in _c_changes(line):
            old = line[slice(*span)]
            place = tuple(start + len(raw[:k].encode()) for k in span)
            yield number, kind, old, new, place, f"{raw.strip()} {span}"
        start += len(raw.encode())


def _c_changes(line: str) -> Iterator[tuple[str, tuple[int, int], str]]:
    declared = C_DECLARATION.match(line) is not None
    for found in C_OPERATOR.finditer(line):
        kind = "comparison" if found[0][0] in "<>!=" else "operator"
        yield kind, found.span(), C_REPLACED[found[0]]
    for found in C_NOT.finditer(line):
        yield "operator", found.span(), ""
    for found in C_NUMBER.finditer(line):
        value = found[0]
        new = str(int(value) + 1) if value.isdigit() else repr(2 * float(value) or 1.0)
        yield "constant", found.span(), new
    for found in C_CONDITION.finditer(line):
        if found[1].count("(") == found[1].count(")"):
            yield "condition", found.span(1), f"!({found[1]})"
    if C_STATEMENT.match(line) and not declared and line.count("(") == line.count(")"):
        yield "deletion", (len(line) - len(line.lstrip()), len(line)), ";"


def draw(paths: list[Path], count: int, seed: int) -> list[Mutant]:
    """`count` mutants of these files, of each kind about as many, first by their key and the seed.

    There are many more constants than comparisons, but comparisons decide. Of functions that are
    alike, such as a method of two classes of the same name, one is drawn from.
    """

    def order(mutant):
        return hashlib.sha256(f"{seed} {mutant.key}".encode()).digest(), mutant.path

    of_kind: dict[str, list[Mutant]] = {}
    unique = {m.key: m for path in sorted(paths, reverse=True) for m in mutants(path)}
    for mutant in sorted(unique.values(), key=order):
        of_kind.setdefault(mutant.kind, []).append(mutant)
    in_turn = sorted((k, order(m), m) for kind in of_kind.values() for k, m in enumerate(kind))
    return list(itertools.islice((m for *_, m in in_turn if _compiles(m)), count))


def _compiles(mutant: Mutant) -> bool:
    if mutant.path.suffix != ".py":
        return True
    try:
        ast.parse(mutant.source())
    except SyntaxError:  # a sign in a pattern, for example
        return False
    return True
