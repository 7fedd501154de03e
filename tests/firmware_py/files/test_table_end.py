"""A table that ends within a number is told from one whose program writes no last line break."""

import pytest

from firmware_py.errors import InputError
from firmware_py.files.table_end import TableEnd


def watched(text):
    watch = TableEnd(iter(text.splitlines(keepends=True)))
    for line in watch.lines():
        watch.see(line.strip())
    return watch


FULL = "1.0129717538476502\n-0.23894731098351773\n0.0\n9.238947310983517e-05\n" * 5
FIXED = "10.123400\n-9.500000\n0.000000\n" * 7


@pytest.mark.parametrize(
    "text",
    [
        FULL + "1.01297\n",  # a line break: the number is whole
        FULL + "2.1389473109835177e-05",
        FULL + "0.0",
        FIXED + "-0.012300",
        "1\n12\n" * 10 + "5",
        "0.10\n0.25\n0.3",  # too few to compare with
        "",
        "4.5",  # nothing to compare with
        FULL,
    ],
)
def test_a_whole_table_is_taken(text):
    assert not watched(text).is_cut


@pytest.mark.parametrize(
    "text",
    [
        FULL + "1.01297",
        FULL + "1",
        FULL + "9.238947310983517e-0",
        FIXED + "-9.5000",
        "1,25\n" * 20 + "0,5",
    ],
)
def test_a_cut_number_is_told(text):
    with pytest.raises(InputError, match=r"row 5, column m16_z_m: the file ends within .*line br"):
        watched(text).refuse_cut("run.csv", 5, "m16_z_m")
