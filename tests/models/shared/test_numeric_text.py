"""Text tables: one that ends within a number is refused, one without a last line break is not."""

from pathlib import Path

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.shared.numeric_text import read_header, read_numbers


def numbers(text, delimiter=","):
    lines = iter(text.splitlines(keepends=True))
    header = read_header(Path("run.csv"), next(lines), delimiter)
    return read_numbers(Path("run.csv"), lines, header, range(len(header)), delimiter)


FULL = "x\n" + "1.0129717538476502\n-0.23894731098351773\n0.0\n9.238947310983517e-05\n" * 5
FIXED = "x\n" + "10.123400\n-9.500000\n0.000000\n" * 7


@pytest.mark.parametrize(
    "text",
    [
        FULL + "1.01297\n",  # a line break: the number is whole
        FULL + "2.1389473109835177e-05",
        FULL + "0.0",
        "x\n" + "1\n12\n" * 10 + "5",
        "x\n0.10\n0.25\n0.3",  # too few to compare with
        "x\n",
        "x\n4.5",  # nothing to compare with
        FULL,
    ],
)
def test_a_whole_table_is_read(text):
    assert numbers(text).shape == (len(text.splitlines()) - 1, 1)


@pytest.mark.parametrize("cut", [FULL + "1", FULL + "9.238947310983517e-0", FIXED + "-9.5000"])
def test_a_file_that_ends_within_a_number_is_refused(cut):
    with pytest.raises(InputError, match=r"row 2\d, column 'x': the file ends within .*line break"):
        numbers(cut)


@pytest.mark.parametrize(
    ("row", "what"),
    [
        ("1,2,3", "row 3 has 3 cells, the header 2"),
        ("1", "row 3 has 1 cells, the header 2; the file is truncated"),
        ("1,2,3,4", "decimal commas"),
        ("1,0_2", r"row 3, column 'y': '0_2' is not a number"),
        ("1,-inf", r"row 3, column 'y': '-inf' is not a finite number"),
        ("10:00:01,2", r"column 'x': .* convert time stamps"),
    ],
)
def test_a_wrong_row_is_refused_by_its_line(row, what):
    with pytest.raises(InputError, match=what):
        numbers(f"x,y\n0,1\n{row}\n")


def test_blank_lines_and_empty_cells_behind_the_row_are_skipped():
    values = numbers("x;y\n0;1;;\n\n;nan\n", ";")
    assert np.array_equal(values, [[0, 1], [np.nan, np.nan]], equal_nan=True)
