"""JSON Schemas of all documents, as the files of `docs/schema/`.

::

    python -m hil.document_schemas docs/schema
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py.documents import Document, schema_of
from models.plant.plant import PlantDocument
from models.study.study_document import StudyDocument

DOCUMENTS: Final[tuple[type[Document], ...]] = (PlantDocument, StudyDocument)
"""Every document that a command writes."""


def schema_files() -> dict[str, str]:
    """Text of each schema by the name of its file."""
    return {
        f"{_file_stem(kind)}.schema.json": json.dumps(schema_of(kind), indent=1) + "\n"
        for kind in DOCUMENTS
    }


def _file_stem(kind: type[Document]) -> str:
    name = kind.__name__.removesuffix("Document")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def main(argv: Sequence[str] | None = None) -> int:
    """Write the schemas into a directory."""
    parser = argparse.ArgumentParser(prog="python -m hil.document_schemas", description=__doc__)
    parser.add_argument("directory", type=Path, help="docs/schema")
    directory: Path = parser.parse_args(argv).directory
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in schema_files().items():
        (directory / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
