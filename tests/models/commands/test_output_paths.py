"""Places to write to: refused before the work if they cannot be written."""

import pytest

from firmware_py.core.errors import InputError
from models.shared.output_paths import check_output_directory, check_output_file


@pytest.fixture
def place(tmp_path):
    """A directory with a file."""
    (tmp_path / "file.toml").write_text("")
    return tmp_path


@pytest.mark.parametrize("name", ["new/deeper", "."])
def test_a_place_that_can_be_written_passes(place, name):
    check_output_directory(place / name, ["other.toml"], [place / "file.toml"])
    check_output_file(place / name / "other.toml", [place / "file.toml"])
    assert [p.name for p in place.iterdir()] == ["file.toml"], "nothing is made"


@pytest.mark.parametrize(
    ("check", "name", "message"),
    [
        (check_output_directory, "file.toml", "is a file"),
        (check_output_directory, "file.toml/new", "lies under the file"),
        (check_output_file, ".", "is a directory"),
        (check_output_file, "file.toml/new.toml", "lies under the file"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused(place, check, name, message):
    with pytest.raises(InputError, match=message):
        check(place / name)


def test_an_input_is_not_overwritten_by_any_of_its_names(place):
    source = place / "file.toml"
    (place / "second.toml").hardlink_to(source)
    for name in ("new/../file.toml", "second.toml"):
        with pytest.raises(InputError, match="is a file that is read"):
            check_output_file(place / name, [source])
    for name in (".", "new/.."):
        with pytest.raises(InputError, match="toml, which is read"):
            check_output_directory(place / name, ["other.toml", "file.toml"], [source])
