"""CasADi's C code of a function, adapted to run for several trials in lockstep.

The code of a function without branches is a list of assignments to numbers. It becomes the same
list of assignments to vectors of `lanes.h`, with one lane per trial. The C compiler rejects code
that this module does not convert: a vector accepts neither a number nor a truth value.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Final

LANES_H: Final = Path(__file__).with_name("lanes.h")
"""Header of the adapted code; N_LANES must be defined."""

_FUNCTION: Final = re.compile(
    r"^/\* (?P<name>\w+):\(.*\n"
    r"static int casadi_f\d+\(.*\{\n(?P<body>(?:  .*\n)*)  return 0;\n\}\n",
    re.MULTILINE,
)

_ADAPTED: Final = [
    (re.compile(pattern), replacement)
    for pattern, replacement in (
        (r"\n  casadi_real ", "\n  Real "),
        (r"=arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0;", r"=arg[\1][\2];"),
        (r"\n  if \(res\[\d+\]!=0\) ", "\n  "),
        (r"=(-?(?:[\d.]+(?:e[-+]?\d+)?|casadi_inf|casadi_nan));", r"=EACH(\1);"),
        (r"=\((a\d+)\?(a\d+):0\);", r"=IF(\1, \2);"),
        (r"=\(!(a\d+)\);", r"=NOT(\1);"),
        (r"=\((a\d+)<(a\d+)\);", r"=LESS(\1, \2);"),
        (r"=\((a\d+)<=(a\d+)\);", r"=LESS_OR_EQUAL(\1, \2);"),
        (r"=\((a\d+)==(a\d+)\);", r"=EQUAL(\1, \2);"),
        (r"=\((a\d+)!=(a\d+)\);", r"=UNEQUAL(\1, \2);"),
        (r"=\((a\d+)&&(a\d+)\);", r"=AND(\1, \2);"),
        (r"=\((a\d+)\|\|(a\d+)\);", r"=OR(\1, \2);"),
        (r"=(?:casadi_)?([b-z]\w*|a[a-z]\w*)\((a\d+(?:,a\d+)?)\);", r"=lanes_\1(\2, lanes);"),
    )
]
"""Patterns of statements and their vector form; sums, products and quotients do not change."""


_REGISTER: Final = re.compile(r"a\d+")
_ASSIGNMENT: Final = re.compile(r"  (a\d+)=(.*);")
_PRODUCT: Final = re.compile(r"\((a\d+)\*(a\d+)\)")
_CALL: Final = re.compile(r"lanes_(sin|cos|tan|tanh|exp|log|erf)\((a\d+), lanes\)")


def in_lanes(code: str) -> str:
    """Convert C code to functions `void name(const Real **arg, Real **res, int lanes)`."""
    parts = ['#include "lanes.h"\n']
    for found in _FUNCTION.finditer(code):
        body = "\n" + found["body"]
        for form, adapted in _ADAPTED:
            body = form.sub(adapted, body)
        head = f"void {found['name']}(const Real **arg, Real **res, int lanes)"
        parts.append(f"{head};\n{head} {{\n  (void)lanes;{_with_fewer_calls(body)}}}\n")
    return "\n".join(parts)


def _with_fewer_calls(body: str) -> str:
    """Body without unnecessary calls of the C library.

    A function whose value is only multiplied by another number is called only if that number is not
    zero, since most effects are absent. Sine and cosine of one number become one call. Results keep
    every bit, except for the sign of a zero and in a simulation that has become unstable.
    """
    lines = body.split("\n")
    statements = [_ASSIGNMENT.fullmatch(line) for line in lines]
    written: dict[str, int] = {}  # the last statement that wrote each register
    reads: list[dict[str, int]] = []
    uses: dict[int, list[int]] = defaultdict(list)
    for k, found in enumerate(statements):
        own = _REGISTER.findall(found[2] if found else lines[k])
        reads.append({name: written.get(name, -1) for name in own})
        for source in reads[k].values():
            uses[source].append(k)
        if found:
            written[found[1]] = k
    angles: dict[int, dict[str, int]] = defaultdict(dict)
    for k, found in enumerate(statements):
        call = _CALL.fullmatch(found[2]) if found else None
        if not found or not call:
            continue
        user = statements[uses[k][0]] if len(uses[k]) == 1 else None
        product = _PRODUCT.fullmatch(user[2]) if user else None
        others = [name for name in product.groups() if name != found[1]] if product else []
        if others and reads[uses[k][0]][others[0]] < k:
            lines[k] = f"  {found[1]}=lanes_{call[1]}_times({call[2]}, {others[0]}, lanes);"
        elif call[1] in ("sin", "cos"):
            angles[reads[k][call[2]]][call[1]] = k
    for pair in angles.values():
        if len(pair) == 2:
            _take_both(lines, pair)
    return "\n".join(lines)


def _take_both(lines: list[str], pair: Mapping[str, int]) -> None:
    """Replace the sine and the cosine of one number, in two statements, by one call."""
    first = min(pair.values())
    argument = _REGISTER.findall(lines[first])[1]
    call = f"lanes_sincos({argument}, &sin{first}, &cos{first}, lanes)"
    for function, k in pair.items():
        lines[k] = f"  {_REGISTER.findall(lines[k])[0]}={function}{first};"
    lines[first] = f"  Real sin{first}, cos{first}; {call};{lines[first][1:]}"
