"""Bounded reading of files from outside: bytes, text, TOML, JSON, archives.

Every reader of this project uses these functions, so that all refuse the same faults in one
sentence: a missing file, no regular file, too large a file, or another format. The limits are in
docs/files/readers.md.
"""

from __future__ import annotations

import codecs
import contextlib
import hashlib
import io
import json
import lzma
import os
import re
import stat
import sys
import tomllib
import zipfile
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Final, NamedTuple, TypeVar

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.units import DATA_SIZE

T = TypeVar("T")

MEMORY_BYTES: Final = 350_000_000
"""Additional memory for reading a file: an importer with 100 MB of loaded libraries stays below
500 MB."""
MOST_BYTES: Final = 100_000_000
"""Size of the largest file that is read: two hours of a trial of the link as CSV [assumed]."""
MOST_CELLS: Final = 10_000_000
"""Most numbers of a table: 80 MB as doubles; a file of `MOST_BYTES` with ten bytes each."""
MOST_TOML_BYTES: Final = 1_000_000
"""Size of the largest TOML file, which tomllib parses in a second [assumed]."""
MOST_JSON_BYTES: Final = 64_000_000
"""Size of the largest JSON document; as text with a wide character it takes 256 MB."""
MOST_JSON_VALUES: Final = 4_000_000
"""Most values of a JSON document, with 32 bytes each as floats."""
MOST_JSON_LISTS: Final = 500_000
"""Most lists and objects of a JSON document, with 64 to 230 bytes each."""
LONGEST_LINE: Final = 1_000_000
"""Characters of the longest line of a table."""
_UTF_16_MARKS: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_MOST_KEY_DOTS: Final = 500
"""Most dots between separators of a TOML file; dotted keys take tomllib quadratic time."""
_TOML_SEPARATOR: Final = re.compile(rb"[,\[\]{}=\n]")


def limit_memory(memory_bytes: int = MEMORY_BYTES) -> tuple[int, int] | None:
    """Limit the address space of this process to its present size and `memory_bytes` more.

    Returns the previous soft and hard limits; None on systems without such a limit (not Linux).
    """
    if sys.platform != "linux":
        return None
    import resource

    statm = Path("/proc/self/statm").read_text(encoding="ascii")
    most = int(statm.split()[0]) * resource.getpagesize() + memory_bytes
    before = resource.getrlimit(resource.RLIMIT_AS)
    known = [limit for limit in before if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([most, *known]), before[1]))
    return before


@contextlib.contextmanager
def limited_memory(
    where: Path | str, remedy: str, memory_bytes: int = MEMORY_BYTES
) -> Iterator[None]:
    """Refuse a file if the code of the block needs more than `memory_bytes` of new memory."""
    before = limit_memory(memory_bytes)
    try:
        yield
    except MemoryError:
        what = f"takes more than {DATA_SIZE.number(memory_bytes)} MB to read"
        raise InputError(where, what, remedy) from None
    finally:
        if before is not None:
            import resource

            resource.setrlimit(resource.RLIMIT_AS, before)


def resolved(path: Path) -> Path:
    """Return the absolute path without links; refuse links that lead back to themselves."""
    try:
        return path.resolve()
    except RuntimeError:  # Python 3.13 returns the path instead, which then cannot be opened
        raise InputError(
            path, "is a symbolic link that leads back to itself", "remove it, or name another path"
        ) from None
    except OSError as error:  # the working directory was removed
        raise InputError(
            path, f"cannot be resolved ({error.strerror})", "name an absolute path"
        ) from None


def open_bounded(path: Path | str, remedy: str, most: int = MOST_BYTES) -> BinaryIO:
    """Open a regular file of at most `most` bytes.

    `remedy`: remedy in the message if the file is missing or not a regular file.
    """
    try:
        # Opening a FIFO without a writer would block.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except FileNotFoundError:
        raise InputError(path, "is missing", remedy) from None
    except OSError as error:
        what = f"cannot be read ({error.strerror})"
        raise InputError(path, what, remedy) from None
    except ValueError as error:  # a NUL in the name
        raise InputError(path, f"is no file name ({error})", remedy) from None
    status = os.fstat(descriptor)
    wrong = ""
    if stat.S_ISDIR(status.st_mode):
        wrong = "is no file but a directory"
    elif not stat.S_ISREG(status.st_mode):
        wrong = "is no file but a device or a pipe"
    if wrong or status.st_size > most:
        os.close(descriptor)
        if wrong:
            raise InputError(path, wrong, remedy)
        what = f"is larger than {DATA_SIZE.number(most)} MB"
        raise InputError(path, what, "shorten it or divide it")
    return os.fdopen(descriptor, "rb")


def read_bytes(path: Path | str, remedy: str, most: int = MOST_BYTES) -> bytes:
    with open_bounded(path, remedy, most) as file:
        try:
            data = file.read(most + 1)  # the file may have grown
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})", remedy) from None
    if len(data) > most:
        raise InputError(
            path, f"is larger than {DATA_SIZE.number(most)} MB", "shorten it or divide it"
        )
    return data


def read_text(path: Path | str, remedy: str, most: int = MOST_BYTES) -> str:
    data = read_bytes(path, remedy, most)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _no_utf_8(path, data, error) from None


def read_lines(path: Path | str, remedy: str) -> Iterator[str]:
    """Yield the lines of a table with their ends: UTF-8, or UTF-16 with a byte order mark."""
    encoding = "utf-8-sig"
    with open_bounded(path, remedy) as data:
        try:
            if data.read(2) in _UTF_16_MARKS:  # Excel and Motive write it
                encoding = "utf-16"
            data.seek(0)
            file = io.TextIOWrapper(data, encoding=encoding, newline="")
            while line := file.readline(LONGEST_LINE + 1):
                if len(line) > LONGEST_LINE:
                    what = f"has a line of more than {LONGEST_LINE} characters"
                    raise InputError(path, what, "write one sample per line")
                yield line
        except UnicodeError as error:
            what = f"is not {encoding.removesuffix('-sig').upper()} text ({error})"
            raise InputError(path, what, "save it as UTF-8") from None
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})", remedy) from None


def read_toml(
    path: Path | str,
    missing: str = "name an existing file",
    damaged: str = "",
    tables: Collection[str] | None = None,
) -> dict[str, Any]:
    """Return the tables of a TOML file; an integer beyond 64 bits is refused, as TOML demands.

    `missing`, `damaged`: remedies in the message if the file is missing or is not TOML.
    `tables`: keys at the top to return; the values of others are not checked. None returns all.
    """
    return parse_toml(path, read_bytes(path, missing, MOST_TOML_BYTES), damaged, tables)


def parse_toml(
    path: Path | str, data: bytes, damaged: str = "", tables: Collection[str] | None = None
) -> dict[str, Any]:
    """Return the tables of the content of a TOML file; see `read_toml`."""
    damaged = damaged or "correct the line it names"
    if max(map(_dots, _TOML_SEPARATOR.split(data))) > _MOST_KEY_DOTS:
        raise InputError(path, f"has a name of more than {_MOST_KEY_DOTS} parts", damaged)
    try:
        document = tomllib.loads(data.decode("utf-8-sig"))  # Notepad of Windows writes a BOM
        if tables is not None:
            document = {key: value for key, value in document.items() if key in tables}
        _check_integers(document)
        return document
    except RecursionError:
        raise InputError(path, "is not TOML (it is too deeply nested)", damaged) from None
    except UnicodeDecodeError as error:
        raise _no_utf_8(path, data, error) from None
    except ValueError as error:  # not TOML, or a number with too many digits
        raise InputError(path, f"is not TOML ({_reason(error)})", damaged) from None


def _reason(error: ValueError) -> str:
    """Return why a text cannot be parsed; Python's advice on long integers is for programmers."""
    text = str(error)
    if "set_int_max_str_digits" in text:
        return f"it holds an integer of more than {sys.get_int_max_str_digits()} digits"
    return text


def _no_utf_8(path: Path | str, data: bytes, error: UnicodeDecodeError) -> InputError:
    is_utf_16 = data.startswith(_UTF_16_MARKS)
    what = "is UTF-16 text" if is_utf_16 else f"is not UTF-8 text ({error})"
    return InputError(path, what, "save it as UTF-8")


def _check_integers(value: Any, name: str = "") -> None:
    """Raise ValueError for an integer that a signed 64-bit number cannot hold."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_integers(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for inner in value:
            _check_integers(inner, name)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError(f"{name[:80]} is an integer beyond 64 bits")


def _dots(piece: bytes) -> int:
    return piece.count(b".")


def check_json(path: Path | str, data: bytes, remedy: str) -> None:
    """Refuse a JSON document that would need too much memory, before it is decoded."""
    lists = data.count(b"[") + data.count(b"{")
    if lists > MOST_JSON_LISTS:
        raise InputError(path, f"holds more than {MOST_JSON_LISTS} lists and objects", remedy)
    if lists + data.count(b",") > MOST_JSON_VALUES:
        raise InputError(path, f"holds more than {MOST_JSON_VALUES} values", remedy)


def read_json(path: Path | str, remedy: str, most: int = MOST_JSON_BYTES) -> Any:
    return decode_json(path, read_bytes(path, remedy, most), remedy)


def decode_json(path: Path | str, data: bytes, remedy: str) -> Any:
    """Decode the content of a JSON file, which `path` names in messages."""
    check_json(path, data, remedy)
    try:
        with limited_memory(path, remedy):
            return json.loads(data, object_pairs_hook=_object)
    except RecursionError:
        raise InputError(path, "is not JSON (it is too deeply nested)", remedy) from None
    except ValueError as error:  # format, encoding, or too many digits of a number
        raise InputError(path, f"is not JSON ({_reason(error)})", remedy) from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object; refuse one with a repeated name."""
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        doubled = next(name for k, name in enumerate(names) if name in names[:k])
        raise ValueError(f"the name {doubled[:80]!r} stands twice in an object")
    return result


def convert(raw: Any, kind: type[T], path: Path | str, what: str, remedy: str) -> T:
    """Convert decoded TOML or JSON to a struct.

    `what`: message if it does not fit, like "is no motion"; empty for the reason alone.
    """
    try:
        return msgspec.convert(raw, kind)
    except (ValueError, OverflowError, RecursionError, TypeError) as error:
        # msgspec's error is a ValueError; an integer may be too large for a double.
        raise InputError(path, f"{what} ({error})" if what else str(error), remedy) from None


MOST_MEMBERS: Final = 1000
"""Most members of an archive; an FMU for four platforms with its sources has 60."""
MOST_UNPACKED_BYTES: Final = 100_000_000
"""Most bytes of all members, unpacked; an FMU of this project has 0.3 MB."""
MOST_TEXT_BYTES: Final = 4_000_000
"""Size of the largest XML member, unpacked; its tree takes thirty times as much memory."""
ARCHIVE_DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, LookupError, RuntimeError,
    ValueError,
)  # fmt: skip
"""Errors of a damaged archive, or of XML in it that names an unknown encoding."""


def check_archive(archive: zipfile.ZipFile, path: Path, remedy: str) -> None:
    """Refuse an archive that unpacks to too many bytes, or outside its directory.

    Unpacking stops at the declared size of a member, so the declared sizes bound the allocation.
    """
    members = archive.infolist()
    names = [member.filename for member in members]
    wrong = ""
    if len(members) > MOST_MEMBERS:
        wrong = f"has {len(members)} members, more than {MOST_MEMBERS}"
    elif len(set(names)) < len(names):
        wrong = "holds two files of one name"
    elif sum(member.file_size for member in members) > MOST_UNPACKED_BYTES:
        wrong = f"unpacks to more than {DATA_SIZE.number(MOST_UNPACKED_BYTES)} MB"
    elif any(m.filename.endswith(".xml") and m.file_size > MOST_TEXT_BYTES for m in members):
        wrong = f"holds an XML file of more than {DATA_SIZE.number(MOST_TEXT_BYTES)} MB"
    else:
        outside = [n for n in names if PurePosixPath(n).is_absolute() or ".." in n.split("/")]
        wrong = f"holds a file with a path outside the archive ({outside[0]})" if outside else ""
    if wrong:
        raise InputError(path, wrong, remedy)


LARGEST_BYTES: Final = 64_000_000
"""Size of the largest file of a bundle; the demo's files have up to 360 kB. [assumed]"""


class FileContent(NamedTuple):
    """Content of a file, read once, so that the hashed bytes are the ones in use."""

    path: Path  # Origin, for messages
    data: bytes

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()


Source = Path | str | FileContent
"""A file by its path, or its content in memory."""


def content_of(source: Source, remedy: str = "copy the whole bundle directory") -> FileContent:
    """Return the content of a file, which is read unless it is in memory already.

    `remedy`: remedy in the message if the file is missing.
    """
    if isinstance(source, FileContent):
        return source
    path = Path(source)
    return FileContent(path, read_bytes(path, remedy, LARGEST_BYTES))
