"""C compiler: shared libraries from the same compiler on every machine (`ziglang` from PyPI).

The flags keep the arithmetic of the source: they do not contract a*b + c into one rounding, so a
compiled model equals the interpreted one (docs/sources.md, "FMI"). Results are cached by content.
It compiles for every platform of `TARGETS` on any of them.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.metadata
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from firmware_py.core.errors import DropstitchError, InputError
from firmware_py.inference.fmu_instance import platform_here

TARGETS: Final[Mapping[str, str]] = {
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-darwin": "x86_64-macos.11.0",
    "aarch64-darwin": "aarch64-macos.11.0",
}
"""Zig's names of platforms, by those of FMI 3.0: Linux with the glibc of 2012, macOS 11."""
CACHE: Final = Path(__file__).parents[2] / "build" / "cache"
"""Directory of compiled libraries, by hash of sources, headers, options and compiler."""
ZIG_CACHE: Final = CACHE / "zig"
"""Zig's C library and objects, 45 MB and more, which would fill a directory of the user's home."""
OPTIONS_VARIABLE: Final = "DROPSTITCH_CC_OPTIONS"
"""Environment variable with further options. "-O0" compiles large models in a tenth of the
time; the code is four times slower and gives the same bits. The tests of short runs use it."""
_FLAGS: Final = (
    "-O2", "-std=c99", "-ffp-contract=off", "-fvisibility=hidden",
    "-fno-sanitize=undefined", "-DCASADI_SYMBOL_EXPORT=", "-s", "-Wl,--build-id=none",
    "-g0",  # no debug information, which is stripped anyway: a third of the compile time
    "-fno-slp-vectorize",  # a quarter of the compile time of a large model, without gain
)  # fmt: skip


def load_library(
    write_sources: Callable[[Path], Sequence[Path]], flags: Sequence[str] = ()
) -> ctypes.CDLL:
    """Compile C sources for this machine and load the library.

    `write_sources` writes files into a temporary directory and returns the sources to compile.
    """
    # Windows does not delete a mapped file: the directory stays there for the system's clean-up.
    with TemporaryDirectory(prefix="dropstitch-", ignore_cleanup_errors=True) as scratch:
        directory = Path(scratch)
        path = compile_library(
            write_sources(directory), directory / "model.so", include=[directory], flags=flags,
            at_once=True,
        )  # fmt: skip
        try:
            return ctypes.CDLL(str(path))  # stays mapped when the file is deleted
        except OSError as error:
            raise InputError(
                directory.parent, f"holds a compiled model that does not load ({error})",
                "set TMPDIR to a directory from which programs may run",
            ) from None  # fmt: skip


def compile_library(
    sources: Sequence[Path],
    output: Path,
    *,
    include: Sequence[Path] = (),
    flags: Sequence[str] = (),
    target: str | None = None,
    at_once: bool = False,
) -> Path:
    """Compile C sources into one shared library.

    Only symbols that a source marks with default visibility are exported; CasADi's are exported if
    `flags` defines CASADI_SYMBOL_EXPORT. `target` is zig's name of the platform, by default this
    machine's. `at_once` compiles two sources at a time.
    """
    options = [*_FLAGS, "-fPIC", "-shared", *flags, *compiler_options()]
    options += ["-target", target or _target_here()]
    return _cached(sources, output, include, options, _compile_at_once if at_once else _compile)


def compile_program(
    source: Path, output: Path, *, target: str, include: Sequence[Path] = ()
) -> Path:
    """Compile one C source into a program that links to the C library dynamically."""
    _cached([source], output, include, [*_FLAGS, "-target", target], _compile)
    output.chmod(0o755)
    return output


def compiler_options() -> list[str]:
    """Additional options of the compiler, from the environment."""
    return os.environ.get(OPTIONS_VARIABLE, "").split()


def _target_here() -> str:
    here = platform_here()
    if here not in TARGETS:
        raise InputError(
            f"platform {here}", "is none that models are compiled for",
            f"use a machine of {', '.join(TARGETS)}",
        )  # fmt: skip
    return TARGETS[here]


def _cached(
    sources: Sequence[Path], output: Path, include: Sequence[Path], options: Sequence[str],
    compile_: Callable[[Sequence[Path], Path, Sequence[Path], Sequence[str]], None],
) -> Path:  # fmt: skip
    cached = CACHE / f"{_key(sources, include, options)}{output.suffix}"
    if not cached.is_file():
        CACHE.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=CACHE, prefix=".compile-") as scratch:
            fresh = Path(scratch) / output.name
            compile_(sources, fresh, include, options)
            fresh.replace(cached)  # atomic: another process may build the same library
    output.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(cached, output)
    return output


def _key(sources: Sequence[Path], include: Sequence[Path], options: Sequence[str]) -> str:
    """Hash of sources, headers in the include directories, options and compiler version."""
    digest = hashlib.sha256(importlib.metadata.version("ziglang").encode())
    digest.update("\0".join(options).encode())
    headers = sorted(h for directory in include for h in directory.glob("*.h"))
    for path in (*sources, *headers):
        digest.update(f"\0{path.name}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:32]


def _compile_at_once(
    sources: Sequence[Path], output: Path, include: Sequence[Path], options: Sequence[str]
) -> None:
    """Compile two sources at a time, each in a compiler process, and link them."""
    objects = [output.with_name(f"{k}_{path.stem}.o") for k, path in enumerate(sources)]
    alone = [option for option in options if option not in ("-shared", "-s")]
    with ThreadPoolExecutor(2) as pool:
        jobs = [
            pool.submit(_compile, [source], path, include, [*alone, "-c"])
            for source, path in zip(sources, objects, strict=True)
        ]
        for job in jobs:
            job.result()
    _compile(objects, output, include, options)


def _compile(
    sources: Sequence[Path], output: Path, include: Sequence[Path], options: Sequence[str]
) -> None:
    command = [
        sys.executable, "-m", "ziglang", "cc", *options,
        *(f"-I{directory}" for directory in include), *map(str, sources), "-o", str(output), "-lm",
    ]  # fmt: skip
    environment = {"ZIG_GLOBAL_CACHE_DIR": str(ZIG_CACHE), **os.environ}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise DropstitchError(f"the C compiler refused {sources[0].name}:\n{done.stderr.strip()}")
