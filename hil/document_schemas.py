"""JSON Schemas of all documents, as the files of `docs/schema/`.

::

    python -m hil.document_schemas docs/schema

The comment beside or above a field of a document is that field's description.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.core.documents import Document
from firmware_py.core.motion import MotionDocument
from firmware_py.goals.goal_map import GoalMap
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle_signature import BundleSignature, NewestBundle
from firmware_py.summary import RunDocument
from hil.campaign.store import CaseRecord, FailureRecord
from hil.campaign.summary import CampaignDocument
from hil.faults.faults_document import FaultsDocument
from hil.sil.timing_document import TimingDocument
from models.gap.report.gap_json import GapDocument
from models.plant.document import PlantDocument
from models.predictor.document import PredictorsDocument
from models.rig.protocol import ConditionsRecord
from models.study.document import StudyDocument

DOCUMENTS: Final[dict[str, type[Document]]] = {
    "run": RunDocument,
    "signature": BundleSignature,
    "newest_bundle": NewestBundle,
    "rig_conditions": ConditionsRecord,
    "campaign/campaign": CampaignDocument,
    "campaign/case": CaseRecord,
    "campaign/failure": FailureRecord,
    "faults": FaultsDocument,
    "gap": GapDocument,
    "goalmap": GoalMap,
    "motion": MotionDocument,
    "plan": TipPlan,
    "plant": PlantDocument,
    "predictors": PredictorsDocument,
    "study": StudyDocument,
    "timing": TimingDocument,
}
"""Every document that a command writes, by the name of its schema file. A command that writes
several has a folder."""

SECTION: Final = r"\n\n *(?:Attributes|Examples)\n"
"""Where the sections of a docstring begin, which explain a class in Python."""
DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema_files() -> dict[str, str]:
    structs = {kind.__name__: kind for kind in _structs(msgspec.Struct)}
    files = {}
    for name, document in DOCUMENTS.items():
        schema = {"$schema": DIALECT} | msgspec.json.schema(document)
        for definition in schema["$defs"].values():
            if text := definition.get("description"):
                definition["description"] = re.split(SECTION, text)[0]
        for struct in schema["$defs"].keys() & structs.keys():
            properties = schema["$defs"][struct]["properties"]
            comments = _comments(structs[struct])
            for field in msgspec.structs.fields(structs[struct]):
                if text := comments.get(field.name):
                    properties[field.encode_name]["description"] = text
        files[f"{name}.schema.json"] = json.dumps(schema, indent=1) + "\n"
    return files


def _structs(base: type[msgspec.Struct]) -> Iterator[type[msgspec.Struct]]:
    for kind in base.__subclasses__():
        yield kind
        yield from _structs(kind)


def _comments(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Comment of each field, including the fields of base classes."""
    comments: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if base.__module__.startswith("msgspec") or not issubclass(base, msgspec.Struct):
            continue
        above: list[str] = []
        for line in inspect.getsource(base).splitlines():
            if match := re.match(r"    (\w+): [^#]*(?:# (.*))?$", line):
                field, beside = match.groups()
                if text := beside or " ".join(above):
                    comments[field] = text
            comment = re.match(r"    # (.*)", line)
            above = [*above, comment[1]] if comment else []
    return comments


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m hil.document_schemas", description=__doc__)
    parser.add_argument("directory", type=Path, help="docs/schema")
    directory: Path = parser.parse_args(argv).directory
    for name, text in schema_files().items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
