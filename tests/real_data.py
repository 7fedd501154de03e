"""Place of the recordings of other machines that some tests use."""

import os
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]


def real_recordings(folder):
    """Directory of one set of recordings; the test is skipped where it is not present.

    `folder`: "bam_xl330", "emps" or "quanser". They lie in the directory that the environment
    variable DROPSTITCH_DATA names, by default in ../shared/data beside the checkout.
    """
    default = CHECKOUT.parent / "shared" / "data"
    path = Path(os.environ.get("DROPSTITCH_DATA", default)) / folder
    if not path.is_dir():
        pytest.skip(f"{path} is not present")
    return path
