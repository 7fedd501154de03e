"""Marker exports of QTM and as TRC are read with their headers as the programs write them."""

import numpy as np
import pytest

from firmware_py.errors import InputError
from models.trials.recordings.mapping import RecordingMap
from models.trials.recordings.table import read_columns, read_table

PLACES_MM = np.arange(18.0).reshape(3, 2, 3) + 0.25
"""Of two markers in three samples."""
MAP = RecordingMap(markers={"m01": "Link A", "m02": "Link B"})


def rows(times=True):
    return [
        "\t".join([*([str(k + 1), f"{k / 100:.5f}"] if times else []), *map(str, mm.ravel())])
        for k, mm in enumerate(PLACES_MM)
    ]


def qtm(form):
    facts = [
        "NO_OF_FRAMES\t3", "NO_OF_CAMERAS\t8", "NO_OF_MARKERS\t2", "FREQUENCY\t100",
        "TIME_STAMP\t2026-11-28, 10:00:00.000\t1234.5", "DATA_INCLUDED\t3D",
        "MARKER_NAMES\tLink A\tLink B", "TRAJECTORY_TYPES\tMeasured\tMeasured",
    ]  # fmt: skip
    if form == "column header":
        names = "\t".join(f"{name} {axis}" for name in ("Link A", "Link B") for axis in "XYZ")
        facts.append(f"Frame\tTime\t{names}")
    return [*facts, *rows(times=form != "positions only")]


def trc(form):
    blank = [""] if form == "blank row" else []
    tail = "\t" if form == "trailing tabs" else ""
    return [
        "PathFileType\t4\t(X/Y/Z)\ttake.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate",
        "100\t100\t3\t2\tmm\t100",
        "Frame#\tTime\tLink A\t\t\tLink B\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        *blank,
        *(row + tail for row in rows()),
    ]


@pytest.mark.parametrize(
    ("make", "form"),
    [(qtm, "column header"), (qtm, "times"), (qtm, "positions only"),
     (trc, ""), (trc, "blank row"), (trc, "trailing tabs")],
)  # fmt: skip
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_time_and_markers_are_found_by_their_names(make, form, end, tmp_path):
    path = tmp_path / "take.tsv"
    path.write_text(end.join(make(form)) + end, newline="")
    (series,) = read_table(path, MAP)
    assert series.time_s == pytest.approx([0.0, 0.01, 0.02])
    for k in range(2):
        assert series.position_m(f"m{k + 1:02d}") == pytest.approx(PLACES_MM[:, k] / 1e3)


def test_the_unit_of_a_trc_file_counts(tmp_path):
    path = tmp_path / "take.trc"
    path.write_text("\n".join(trc("")).replace("\tmm\t", "\tm\t"))
    (series,) = read_table(path, MAP)
    assert series.position_m("m02") == pytest.approx(PLACES_MM[:, 1])


def test_an_unseen_marker_is_empty_and_a_short_row_is_told_with_its_number(tmp_path):
    path = tmp_path / "take.tsv"
    lines = qtm("column header")
    lines[-1] = "\t".join([*lines[-1].split("\t")[:5], "", "", ""])
    path.write_text("\n".join(lines))
    (series,) = read_table(path, MAP)
    assert np.isnan(series.position_m("m02")[-1]).all()
    lines[-1] = "3\t0.02\t1.0"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="row 12 has 3 cells, the header 8"):
        read_table(path, MAP)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("NO_OF_FRAMES\t3\n1\t0.0\t1.0\n", "without MARKER_NAMES"),
        ("NO_OF_FRAMES\t1\nMARKER_NAMES\tA\n1.0\t2.0\t3.0\n", "neither times nor FREQUENCY"),
        ("PathFileType\t4\n", "without names of markers"),
        ("NO_OF_FRAMES\t1\nMARKER_NAMES" + "\tA" * 400 + "\n1.0\n", "has 400 markers, more than"),
    ],
)
def test_a_header_that_lacks_something_is_told(text, words, tmp_path):
    path = tmp_path / "take.tsv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_table(path, MAP)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("a,b\n0,017,1,5\n", "decimal commas"),
        ("a,b\n0.017,1.5,2.5,3.5\n", "remove rows that stand above the header"),
        ("Taken by\tme\nt\tx\ty\n0.1\t1.5\t2.5\n", "remove rows that stand above the header"),
        ("a,b,c\n1,2\n", "truncated or damaged"),
    ],
)
def test_decimal_commas_are_named_only_where_a_number_was_split(text, remedy, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_columns(path)
    assert remedy in str(error.value)


@pytest.mark.parametrize("stamp", ["2026-11-28T10:00:01.691", "2026-11-28 10:00:01", "10:00:01.5"])
def test_a_time_stamp_is_told_as_one(stamp, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(f"stamp,x\n{stamp},1\n")
    with pytest.raises(InputError, match="convert time stamps to seconds"):
        read_columns(path)
