"""Checks of --out before the work begins."""

import sys

import pytest

from firmware_py.core.errors import InputError
from models.shared.output_paths import check_output_directory, check_output_file


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="from then on only writing to it fails")
@pytest.mark.parametrize("check", [check_output_directory, check_output_file])
@pytest.mark.parametrize("name", ["loop", "loop/below"])
def test_a_loop_of_links_is_refused_before_the_work(tmp_path, check, name):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="is a symbolic link that leads back to itself"):
        check(tmp_path / name)
