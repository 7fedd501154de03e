"""Output files: whole or as they were, whatever the system refuses."""

import errno
import os
import stat
from pathlib import Path

import pytest

from firmware_py.core.output_files import replacing, write_whole


def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path):
    """The system names no file when a write fails, as Linux does for a full disk."""
    path = tmp_path / "plant.json"
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="plant") as refused, replacing(path) as scratch:
        scratch.write_bytes(b"ne")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert refused.value.filename == str(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path], "nothing is left beside it"


def test_the_new_content_replaces_the_old(tmp_path):
    path = tmp_path / "plant.json"
    for content in (b"old and longer", b"new"):
        write_whole(path, content)
        assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.name == "nt", reason="links need a privilege there")
def test_a_link_to_a_file_stays_a_link(tmp_path):
    path, link = tmp_path / "plant_3.json", tmp_path / "plant.json"
    path.write_bytes(b"old")
    link.symlink_to(path)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert path.read_bytes() == b"new"


@pytest.mark.skipif(os.name == "nt", reason="has no such device")
def test_a_device_is_written_in_place():
    write_whole(Path(os.devnull), b"x")
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no such device")
def test_a_device_that_is_full_is_named():
    with pytest.raises(OSError, match="/dev/full"):
        write_whole(Path("/dev/full"), b"x")
