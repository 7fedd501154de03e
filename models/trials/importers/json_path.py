"""Paths into nested JSON: values by a dotted path or a JSON pointer.

`samples[].motor.position` is one value of every entry of a list, `channels.force` a whole list.
`[]` (in a pointer: `*`) stands for every entry of a list, `[2]` for the third one::

    samples[].motor.position      /samples/*/motor/position
    samples[].force[0]            /samples/*/force/0
    rig.load.force                /rig/load/force

A pointer follows RFC 6901 (`~1` is a slash, `~0` a tilde) except for the `*`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py.errors import InputError

__all__ = ["json_values"]

EVERY: Final = "*"
_TOKEN: Final = re.compile(r"([^.\[\]]+)|\[(\d*)\]")


def json_values(where: Path, document: Any, path: str) -> Sequence[Any]:
    """Values at a path; None for an entry of a list that lacks the last names of the path."""
    found = _follow(where, document, path, _tokens(path), 0)
    if not isinstance(found, list) or any(isinstance(v, dict | list) for v in found):
        raise InputError(
            where, f"{path!r} leads to {_kind(found)}, not to a list of single values",
            "add '[]' where a list has one entry per sample, or the name of a value",
        )  # fmt: skip
    if all(v is None for v in found):
        raise InputError(where, f"{path!r} leads to no value", "correct 'from' in MAP.toml")
    return found


def _tokens(path: str) -> list[str]:
    if path.startswith("/"):
        return [t.replace("~1", "/").replace("~0", "~") for t in path[1:].split("/")]
    return [name or index or EVERY for name, index in _TOKEN.findall(path)]


def _follow(where: Path, node: Any, path: str, tokens: list[str], depth: int) -> Any:
    """Value below a node, or a list of values if the path passes every entry of a list."""
    if depth == len(tokens):
        return node
    token = tokens[depth]
    if token == EVERY and isinstance(node, list):
        if EVERY in tokens[depth + 1 :]:
            raise InputError(
                where, f"{path!r} passes every entry of two lists", "give one of them a number"
            )
        return _of_every_entry(where, node, path, tokens, depth)
    if isinstance(node, dict) and token in node:
        return _follow(where, node[token], path, tokens, depth + 1)
    if isinstance(node, list) and token.isdigit() and int(token) < len(node):
        return _follow(where, node[int(token)], path, tokens, depth + 1)
    raise InputError(where, _dead_end(path, node, tokens, depth), "correct 'from' in MAP.toml")


def _of_every_entry(
    where: Path, entries: list[Any], path: str, tokens: list[str], depth: int
) -> list[Any]:
    """Value of each entry, None if it has none; fails if no entry has one."""
    result: list[Any] = []
    first: InputError | None = None
    for entry in entries:
        try:
            result.append(_follow(where, entry, path, tokens, depth + 1))
        except InputError as error:
            first = first or error
            result.append(None)
    if first is not None and all(v is None for v in result):
        raise first
    return result


def _dead_end(path: str, node: Any, tokens: list[str], depth: int) -> str:
    """Message that says where a path ends."""
    before = ".".join(tokens[:depth]).replace(f".{EVERY}", "[]") or "the file"
    if isinstance(node, dict):
        has = f"it has {', '.join(map(repr, list(node)[:20])) or 'no names'}"
    elif isinstance(node, list):
        has = f"it is a list of {len(node)}: write '[]' for every entry"
    else:
        has = f"it is {_kind(node)}"
    wanted = "list" if tokens[depth] == EVERY else repr(tokens[depth])
    return f"{path!r}: {before} holds no {wanted}; {has}"


def _kind(node: Any) -> str:
    if isinstance(node, dict):
        return "an object"
    if isinstance(node, list):
        return "a list of lists or objects"
    return "nothing" if node is None else "a single value"
