"""JSON documents that programs write and read: one struct each, with a version and a schema.

A document is a `Document`: a frozen msgspec struct whose first field is the version of its format.
Only one module reads and writes each kind, through `read_document` and `write_document`. Its JSON
Schema is in `docs/schema/`.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, TypeVar

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import (
    MOST_JSON_BYTES,
    check_json,
    convert,
    limited_memory,
    read_bytes,
)
from firmware_py.core.output_files import write_whole

T = TypeVar("T", bound="Document")


class Document(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every document.

    Attributes
    ----------
    schema : int
        Version of the format, `VERSION` of the class. It increases with every change that an old
        reader would misread.
    """

    VERSION: ClassVar[int] = 1
    MADE_BY: ClassVar[str] = ""
    """Command that writes the document, named in the message about another version."""

    schema: int


def read_document(path: Path, kind: type[T]) -> T:
    remedy = f"write it anew with {kind.MADE_BY}"
    data = read_bytes(path, remedy, MOST_JSON_BYTES)
    check_json(path, data, remedy)
    try:
        with limited_memory(path, remedy):
            raw = msgspec.json.decode(data)
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"is no JSON document ({error})", remedy) from error
    check_version(path, raw, kind.VERSION, remedy)
    return convert(raw, kind, path, "does not fit its schema", remedy)


def check_version(path: Path, raw: object, version: int, remedy: str) -> None:
    """Refuse a decoded document of another version; `remedy` names the command that makes it."""
    of_file = raw.get("schema") if isinstance(raw, dict) else None
    if of_file != version:
        what = "has no schema version" if of_file is None else f"has schema version {of_file}"
        raise InputError(path, f"{what}, this release reads version {version}", remedy)


def write_document(path: Path, document: Document) -> None:
    """Write a document atomically as indented JSON; NaN and infinities become null."""
    write_whole(path, msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")
