"""Documents and output files: round trip, refusals, whole or as they were."""

import errno
import json
import os
import stat
from pathlib import Path

import pytest

from firmware_py.core.documents import Document, read_document, write_document
from firmware_py.core.errors import InputError
from firmware_py.core.output_files import replacing, write_whole


class Sample(Document, frozen=True, kw_only=True):
    VERSION = 2
    MADE_BY = "dropstitch gap"

    tip_x_m: float
    note: str | None = None


def test_a_document_is_read_as_it_was_written(tmp_path):
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
def test_a_document_that_does_not_fit_is_refused_with_file_reason_and_remedy(
    tmp_path, text, reason
):
    path = tmp_path / "sample.json"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_document(path, Sample)
    message = str(refused.value)
    assert str(path) in message and reason in message and "dropstitch gap" in message


def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path):
    """The system names no file when a write fails, as Linux does for a full disk."""
    path = tmp_path / "plant.json"
    for content in (b"older and longer", b"old"):
        write_whole(path, content)
    with pytest.raises(OSError, match="plant") as refused, replacing(path) as scratch:
        scratch.write_bytes(b"ne")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert refused.value.filename == str(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path], "no scratch file stays beside it"


@pytest.mark.skipif(os.name == "nt", reason="links need a privilege, and devices differ")
def test_a_link_stays_a_link_and_a_device_a_device(tmp_path):
    path, link = tmp_path / "plant_3.json", tmp_path / "plant.json"
    path.write_bytes(b"old")
    link.symlink_to(path)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert path.read_bytes() == b"new"
    write_whole(Path(os.devnull), b"x")
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)
    if Path("/dev/full").exists():
        with pytest.raises(OSError, match="/dev/full"):
            write_whole(Path("/dev/full"), b"x")
