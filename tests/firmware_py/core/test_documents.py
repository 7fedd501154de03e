"""Documents: round trip, and refusals of files that do not fit."""

from __future__ import annotations

import json

import pytest

from firmware_py.core.documents import Document, read_document, write_document
from firmware_py.core.errors import InputError


class Sample(Document, frozen=True, kw_only=True):
    VERSION = 2
    MADE_BY = "dropstitch gap"

    tip_x_m: float
    note: str | None = None


def test_what_is_written_is_read_back(tmp_path):
    path, sample = tmp_path / "sample.json", Sample(schema=2, tip_x_m=0.1 + 0.2)
    write_document(path, sample)
    assert read_document(path, Sample) == sample
    assert json.loads(path.read_text())["tip_x_m"] == 0.1 + 0.2


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"tip_x_m": 1.0}', "no schema version"),
        ('{"schema": 1, "tip_x_m": 1.0}', "schema version 1, this release reads version 2"),
        ('{"schema": 2}', "tip_x_m"),
        ('{"schema": 2, "tip_x_m": "far"}', "tip_x_m"),
        ('{"schema": 2, "tip_x_m": 1.0, "tip": 1.0}', "tip"),
        ('{"schema": 2, "tip_x_m"', "no JSON document"),
        ("[]", "no schema version"),
    ],
)
def test_what_does_not_fit_is_refused_with_file_reason_and_remedy(tmp_path, text, reason):
    path = tmp_path / "sample.json"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_document(path, Sample)
    message = str(refused.value)
    assert str(path) in message and reason in message and "dropstitch gap" in message
