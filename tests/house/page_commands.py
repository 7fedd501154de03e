"""Commands of a page's shell blocks, checked by the parsers and files that they need.

A command of this project is parsed by its own argument parser, with its work left out. A file that
it reads has to be in the repository, to be made by an earlier command of the page or by
`make demo`, or to be a placeholder: a name in capitals (`DIR`, `LOG.mcap`). A target of make has
to exist.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import itertools
import os
import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from dropstitch.__main__ import main
from firmware_py.commands.command_table import COMMANDS
from firmware_py.core import console
from tests.house.sources import ROOT

PROGRAM: Final = "dropstitch"

FOREIGN: Final = {
    ".", "cd", "git", "gcc", "mkdir", "pip", "python3", "scp", "ssh", "unzip", "fmpy", "systemctl",
    "udevadm", "fmu_host", "pre-commit",
}  # fmt: skip
"""Programs of others, of which only the files and extras are checked."""

OUTPUTS: Final = ("out", "link", "key")
"""Arguments that name what a command writes."""


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
def made_by_the_demo() -> frozenset[str]:
    """Files and directories that `make demo` and `make ssp` write."""
    clean = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL")}
    done = subprocess.run(
        ["make", "--dry-run", "--always-make", "--directory", ROOT, "build/report.html", "ssp"],
        capture_output=True, text=True, check=True, env=clean,
    )  # fmt: skip
    return frozenset(re.findall(r"\bbuild/[\w./]+", done.stdout))


@functools.cache
def targets_of_make() -> frozenset[str]:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    (declared,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    return frozenset(declared.split())


@functools.cache
def extras() -> frozenset[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return frozenset(project["optional-dependencies"])


class PageCommands:
    """Check of the commands of one page, in their order.

    `placeholders` are files that stand for the reader's own, beside those in capitals.
    """

    def __init__(self, placeholders: Sequence[str] = ()) -> None:
        self._known = {*placeholders}

    def check(self, words: Sequence[str]) -> None:
        """Check one command; an AssertionError says what a reader would run into."""
        words = list(words)
        while words and (words[0] == "sudo" or re.fullmatch(r"[A-Z_]+=.*", words[0])):
            words.pop(0)
        line, name = " ".join(words), Path(words[0]).name or words[0]
        if name == PROGRAM:
            self._check_own(words[1:], line)
        elif name == "make":
            wanted = [w for w in words[1:] if "=" not in w and not w.startswith("-")]
            missing = [w for w in wanted if w not in targets_of_make()]
            assert not missing, f"{line}: make has no target {missing}"
        elif name == "python" and words[1] != "-m":
            assert (ROOT / words[1]).is_file(), f"{line}: no program {words[1]}"
        elif name == "python":
            assert importlib.util.find_spec(words[2]), f"{line}: no module {words[2]}"
        else:
            assert name in FOREIGN, f"{line}: {words[0]} is no known program"
            self._check_foreign(words, line)

    def _check_own(self, arguments: list[str], line: str) -> None:
        parsed = parse(arguments)
        assert parsed is not None, f"{line}: its parser refuses it"
        for key, value in vars(parsed).items():
            for path in value if isinstance(value, list) else [value]:
                if isinstance(path, Path) and str(path) in arguments:
                    if key in OUTPUTS:
                        self._known.add(str(path))
                    else:
                        assert self._exists(str(path)), f"{line}: nothing makes {path}"

    def _exists(self, path: str) -> bool:
        if re.fullmatch(r"[A-Z][A-Z_]*(\.\w+)?|~.*|/dev/.*|unix:.*", path):
            return True
        demo = made_by_the_demo()
        made = [*self._known, *demo]
        return path in self._known or path in demo or (ROOT / path).exists() or any(
            known.startswith(f"{path}/") or path.startswith(f"{known}/") for known in made
        )  # fmt: skip

    def _check_foreign(self, words: Sequence[str], line: str) -> None:
        for option, word in itertools.pairwise(words):
            for names in re.findall(r"dropstitch\S*\[([a-z,]+)\]", word):
                missing = set(names.split(",")) - extras()
                assert not missing, f"{line}: there is no extra {missing}"
            if option in ("-d", "-o"):
                self._known.add(word)
            elif re.match(r"(requirements|build|docs|fmu|models|robot\.toml)\b", word):
                assert self._exists(word), f"{line}: nothing makes {word}"


def parse(arguments: Sequence[str]) -> argparse.Namespace | None:
    """Arguments as the command's own parser reads them; None where it refuses them."""
    chosen = console.chosen_command(COMMANDS, arguments)
    if chosen is None:
        return None
    module: Any = importlib.import_module(chosen.module)
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
