"""Mutations of files: of bytes, of text, and of trees as JSON and TOML hold them."""

import copy
import json
import re

import tomli_w

NUMBERS = (
    "", "0", "-0", "-1", "3", "65536", "-9223372036854775809", "1e999", "-1e308", "1e-320", "nan",
    "inf", "1_0", "0x1f", "٣", "9" * 5000, "1" + "0" * 20, "1e18", "true", "null", "[]", "{}",
    '"x"', "x", "1979-05-27", "0.0.0", ",", ";", "\t", "\n", "\0",
)  # fmt: skip
VALUES = (
    None, True, 0, -1, 2**31, 2**64, -(2**70), 10**400, 0.0, 1e308, 1e-320, float("nan"),
    float("inf"), "", "x", "\0", "../../x", "/etc/passwd", "é" * 300, "\ud800", "a\nb", [], {},
    [[]], [None], [1e308] * 50, {"": ""}, "9" * 5000, "1e5",
)  # fmt: skip
EDGES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
DEEP = ("[", "{", '{"a":', "[[a]]\n", "a.", "(", "<a>")
LONGEST = 200_000
"""Bytes of the largest mutated file."""


def of_bytes(rng, data):
    """Bytes with one to five random changes."""
    data = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 1, 2, 3, 5))):
        at, other = (rng.randrange(len(data) + 1) for _ in range(2))
        size, width = rng.choice((1, 2, 4, 16, 64, 512)), rng.choice((1, 2, 4, 8))
        edge = rng.choice(EDGES) & (2 ** (8 * width) - 1)
        cut, new = rng.choice((
            (1, bytes([rng.randrange(256)])),
            (width, edge.to_bytes(width, rng.choice(("little", "big")))),
            (width, edge.to_bytes(width, "little")),
            (0, rng.randbytes(size)),
            (size, b""),
            (size, bytes(size)),
            (0, bytes(data[other : other + size]) * rng.choice((1, 2, 50))),
            (rng.choice((0, len(data))), b""),
        ))  # fmt: skip
        data[at : at + cut] = new
    return bytes(data[:LONGEST])


def of_text(rng, data):
    """Text with one to three changes of numbers, words, lines, nesting or encoding."""
    text = data.decode("utf-8", "replace")
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = rng.choice((_number, _number, _word, _line, _line, _nested))(rng, text)
    text = text[:LONGEST]
    encoding = rng.choice(("utf-8",) * 12 + ("latin-1", "utf-16", "utf-8-sig"))
    return text.encode(encoding, "replace")


def _replaced(rng, text, pattern, choices):
    found = list(re.finditer(pattern, text[:20_000]))
    if not found:
        return text + rng.choice(choices)
    hit = rng.choice(found)
    return text[: hit.start()] + rng.choice(choices) + text[hit.end() :]


def _number(rng, text):
    return _replaced(rng, text, r"-?\d[\d.eE+-]*", NUMBERS)


def _word(rng, text):
    words = re.findall(r"[A-Za-z_][\w:/]*", text[:20_000]) or ["x"]
    other = (rng.choice(words), rng.choice(words), "", "schema", rng.choice(words) + "_2")
    return _replaced(rng, text, r"[A-Za-z_][\w:/]*", other)


def _line(rng, text):
    lines = text.split("\n")
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    cells = lines[at].split(",")
    cells[rng.randrange(len(cells))] = rng.choice((*NUMBERS, cells[0], cells[-1]))
    tail = rng.choice((",", '"', "#", "=", "]", "}", "\0", "\r", " " * 500))
    lines[at : at + 1] = rng.choice((
        [],
        [lines[other], lines[at]],
        [lines[at][: rng.randrange(len(lines[at]) + 1)]],
        [lines[at]] * rng.choice((2, 100)),
        [",".join(cells)],
        [lines[at] + tail],
    ))  # fmt: skip
    return "\n".join(lines)


def _nested(rng, text):
    at, depth = rng.randrange(len(text) + 1), rng.choice((2, 100, 3000, 40_000))
    return text[:at] + rng.choice(DEEP) * depth + text[at:]


def of_json(rng, data):
    """JSON with one to three nodes changed; sometimes its text or bytes instead."""
    return _of_tree(rng, data, json.loads, lambda tree: json.dumps(tree).encode())


def of_toml(rng, data, loads):
    """TOML with one to three nodes changed; sometimes its text or bytes instead."""
    return _of_tree(rng, data, loads, lambda tree: tomli_w.dumps(tree).encode())


def _of_tree(rng, data, loads, dumps):
    if rng.random() < 0.4:
        return rng.choice((of_text, of_text, of_bytes))(rng, data)
    tree = loads(data.decode())
    try:
        for _ in range(rng.choice((1, 1, 2, 3))):
            tree = of_tree(rng, tree)
        return dumps(tree)[:LONGEST]
    except (TypeError, ValueError, RecursionError, AttributeError):  # what the form cannot express
        return of_text(rng, data)


def of_tree(rng, tree):
    """Tree in which one node was replaced, removed, renamed, repeated or nested."""
    tree = copy.deepcopy(tree)
    places = list(_places(tree))
    if not places:
        return rng.choice(VALUES)
    parent, key = rng.choice(places)
    kind = rng.randrange(8)
    if kind <= 3:
        parent[key] = rng.choice(VALUES)
    elif kind == 4:
        del parent[key]
    elif kind == 5:
        other, name = rng.choice(places)
        parent[key] = copy.deepcopy(other[name])
    elif kind == 6 and isinstance(parent, dict):
        parent[rng.choice(("", "x", "schema", f"{key}_2", "\0", "a.b"))] = parent.pop(key)
    elif kind == 6:
        parent[key : key + 1] = [parent[key]] * rng.choice((0, 2, 300))
    else:
        for _ in range(rng.choice((1, 5, 400))):
            parent[key] = rng.choice(([parent[key]], {"a": parent[key]}))
    return tree


def _places(node):
    if not isinstance(node, dict | list):
        return
    children = node.items() if isinstance(node, dict) else enumerate(node)
    for key, child in children:
        yield node, key
        if isinstance(child, dict | list) and len(child) < 5000:
            yield from _places(child)
