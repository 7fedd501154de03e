"""Places to write to: refused before the work where they cannot be written."""

import pytest

from firmware_py.errors import InputError
from models.commands.output_paths import check_output_directory, check_output_file


@pytest.fixture
def known(tmp_path):
    """A directory with a file."""
    (tmp_path / "file.toml").write_text("")
    return tmp_path


@pytest.mark.parametrize("place", ["new", "new/deeper", "."])
def test_what_can_be_written_passes(known, place):
    check_output_directory(known / place)
    check_output_file(known / place / "other.toml", [known / "file.toml"])
    assert [p.name for p in known.iterdir()] == ["file.toml"], "nothing is made"


@pytest.mark.parametrize(
    ("check", "place", "said"),
    [
        (check_output_directory, "file.toml", "is a file"),
        (check_output_directory, "file.toml/new", "lies under the file"),
        (check_output_file, ".", "is a directory"),
        (check_output_file, "file.toml/new.toml", "lies under the file"),
    ],
)
def test_what_cannot_be_written_is_refused(known, check, place, said):
    with pytest.raises(InputError, match=said):
        check(known / place)


def test_what_is_read_is_not_overwritten(known):
    with pytest.raises(InputError, match="is a file that is read"):
        check_output_file(known / "new" / ".." / "file.toml", [known / "file.toml"])


def test_a_directory_that_would_get_a_file_that_is_read_is_refused(known):
    check_output_directory(known, ["other.toml"], [known / "file.toml"])
    for place in (known, known / "new" / ".."):
        with pytest.raises(InputError, match="toml, which is read"):
            check_output_directory(place, ["other.toml", "file.toml"], [known / "file.toml"])


def test_a_file_of_two_names_is_one_file(known):
    (known / "second.toml").hardlink_to(known / "file.toml")
    with pytest.raises(InputError, match="is a file that is read"):
        check_output_file(known / "second.toml", [known / "file.toml"])
