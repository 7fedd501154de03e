"""Commands of a page's shell blocks, parsed by the argument parsers of this project."""

import argparse
import functools
import importlib
import re
import shlex
import tomllib
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from dropstitch.__main__ import main
from firmware_py.commands.command_table import COMMANDS
from firmware_py.core import console
from tests.house.sources import ROOT

PROGRAM = "dropstitch"
FOREIGN = {
    ".", "cd", "git", "gcc", "mkdir", "pip", "python3", "scp", "ssh", "unzip", "fmpy", "systemctl",
    "udevadm", "fmu_host", "pre-commit",
}  # fmt: skip
"""Programs of others; of their arguments only the extras of this project are checked."""


def blocks(text: str) -> list[str]:
    return re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(text: str) -> Iterator[list[str]]:
    """Words of every command of a page's shell blocks, in order, comments left out.

    Commands that head the rows of a table follow, but for those that leave something out ("…").
    """
    rows = re.findall(r"^\| `((?:python -m|dropstitch|make) [^`…]+)` \|", text, re.MULTILINE)
    for block in [*blocks(text), *rows]:
        for line in block.replace("\\\n", " ").splitlines():
            lexer = shlex.shlex(line, posix=True, punctuation_chars="&|;")
            lexer.whitespace_split = True
            words: list[str] = []
            for word in [*lexer, "&&"]:
                if set(word) <= set("&|;"):
                    if words:
                        yield words
                    words = []
                else:
                    words.append(word)


@functools.cache
def targets_of_make() -> frozenset[str]:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    (declared,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    return frozenset(declared.split())


@functools.cache
def extras() -> frozenset[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return frozenset(project["optional-dependencies"])


def objection(words: Sequence[str]) -> str:
    """What a reader would run into with a command; empty if nothing."""
    words = list(words)
    while words[0] == "sudo" or re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words.pop(0)
    name = Path(words[0]).name or words[0]
    if name == PROGRAM:
        return "" if parse(words[1:]) is not None else "its parser refuses it"
    if name == "make":
        wanted = {w for w in words[1:] if "=" not in w and not w.startswith("-")}
        return "make has no such target" if wanted - targets_of_make() else ""
    if name == "python":
        is_there = find_spec(words[2]) if words[1] == "-m" else (ROOT / words[1]).is_file()
        return "" if is_there else "no such module or program"
    if name not in FOREIGN:
        return "is no known program"
    for named in re.findall(r"dropstitch\S*?\[([a-z,]+)\]", " ".join(words)):
        if missing := set(named.split(",")) - extras():
            return f"there is no extra {missing}"
    return ""


def parse(arguments: Sequence[str]) -> argparse.Namespace | None:
    """Arguments as the command's own parser reads them; None where it refuses them."""
    chosen = console.chosen_command(COMMANDS, arguments)
    if chosen is None:
        return None
    module = importlib.import_module(chosen.module)
    read: list[argparse.Namespace] = []
    work = module.run

    def only_read(args: argparse.Namespace) -> int:
        read.append(args)
        return console.DONE

    module.run = only_read
    try:
        main(list(arguments))
    finally:
        module.run = work
    return read[0] if read else None
