"""Paths: shapes by their geometry, the font, files, and what is refused."""

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.signals import PERIOD_S
from models.plan.paths import (
    GLYPHS,
    LEAD_S,
    REST_S,
    SETTLE_S,
    SHAPES,
    PathOptions,
    built_in_path,
    read_path,
    text_strokes,
    timeline,
)


def shape(name, dof=2, **options):
    return built_in_path(name, dof, PERIOD_S, PathOptions(**options)).tip_m


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_has_its_size_and_begins_and_ends_at_rest(name):
    tip = shape(name, size_m=0.25, seconds=6.0)
    assert np.max(np.abs(tip)) == pytest.approx(0.25, abs=2e-3)
    speed = np.linalg.norm(np.diff(tip, axis=0), axis=1) / PERIOD_S
    assert max(speed[0], speed[-1]) < 0.02
    assert speed.max() < 1.5
    acceleration = np.linalg.norm(np.diff(tip, 2, axis=0), axis=1) / PERIOD_S**2
    assert acceleration.max() < 10.0, "no jump of the speed"


def test_shapes_pass_the_places_of_their_geometry():
    circle = shape("circle", size_m=0.2, centre_m=(0.1, -0.05), seconds=4.0, turns=2)
    assert len(circle) == pytest.approx(8.0 / PERIOD_S, abs=2)
    assert np.hypot(circle[:, 0] - 0.1, circle[:, 1] + 0.05) == pytest.approx(0.2)
    assert circle[0] == pytest.approx(circle[-1])
    corners = [("square", (x, y)) for x in (0.2, -0.2) for y in (0.2, -0.2)]
    for name, corner in [*corners, ("star", (0.0, 0.2))]:
        assert np.min(np.linalg.norm(shape(name, size_m=0.2) - corner, axis=1)) < 1e-3
    line = shape("line", size_m=0.3, angle_rad=np.pi / 2)
    assert np.abs(line[:, 0]).max() < 1e-12
    assert line[:, 1].max() == pytest.approx(0.3, abs=1e-3)


def test_every_letter_fills_its_cell_and_a_text_lifts_between_strokes():
    for letter in set(GLYPHS) - {" "}:
        assert np.max(np.abs(np.concatenate(text_strokes(letter)))) == pytest.approx(1.0)
    path = built_in_path("text:HI", 2, PERIOD_S, PathOptions(size_m=0.2))
    assert len(path.drawn) == 4, "three strokes of H, one of I"
    assert all(0 <= start < end <= len(path.tip_m) for start, end in path.drawn)


@pytest.mark.parametrize(
    ("name", "dof", "options", "sentence"),
    [
        ("spiral", 2, {}, "no built-in path and no CSV file"),
        ("circle", 1, {}, "the arm has one joint"),
        ("text:Ü", 2, {}, "which the font lacks"),
        ("text: ", 2, {}, "is empty"),
        ("circle", 2, {"seconds": float("nan")}, r"--seconds: is nan"),
        ("line", 1, {"centre_m": (0.0, 0.1)}, r"--centre: has 2 coordinates"),
        ("circle", 2, {"centre_m": (0.0, -3.0)}, r"--centre: is -3; choose -2 to 2"),
        ("line", 1, {"angle_rad": 0.5}, r"--angle-deg: is for line, .* with two joints; leave"),
        ("circle", 2, {"move_s": 1.0}, r"--move: is for point_to_point; leave it out"),
        ("text:HI", 2, {"turns": 2}, r"--turns: a text is written once"),
    ],
)
def test_paths_that_cannot_be_drawn_are_refused(name, dof, options, sentence):
    with pytest.raises(InputError, match=sentence):
        built_in_path(name, dof, PERIOD_S, PathOptions(**options))


@pytest.fixture
def file(tmp_path):
    return tmp_path / "path.csv"


def test_a_file_is_interpolated_to_the_control_period(file):
    file.write_text("time_s,x_m,y_m\n0,0,0\n1,0.1,0.2\n\n3,0.1,0\n")
    assert read_path(file, 2, 0.5).tip_m == pytest.approx(
        np.array([[0, 0], [0.05, 0.1], [0.1, 0.2], [0.1, 0.15], [0.1, 0.1], [0.1, 0.05], [0.1, 0]])
    )
    file.write_text("time_s,x_m\n0,0\n0.5,0.1\n1.003,0.1\n")
    assert read_path(file, 1, PERIOD_S).tip_m[-1, 0] == 0.1, "it ends at rest at its last place"


@pytest.mark.parametrize("rows", [60, 60.3, 60.7])
def test_a_path_that_ends_in_motion_keeps_its_speed_between_two_periods(file, rows):
    """The way back begins with the speed of the path, wherever between two rows that ends."""
    speed_m_s, end_s = 0.3, rows * PERIOD_S
    file.write_text(f"time_s,x_m\n0,0\n{end_s!r},{speed_m_s * end_s!r}\n")
    path = read_path(file, 1, PERIOD_S)
    assert abs(len(path.tip_m) - 1 - rows) <= 0.5, "it ends at the nearer row"
    assert np.diff(path.tip_m[:, 0]) / PERIOD_S == pytest.approx(speed_m_s)
    way = timeline(path, np.zeros(1), PERIOD_S)
    rates = np.diff(way.desired_m[way.end_row - 3 : way.end_row + 3, 0]) / PERIOD_S
    assert np.abs(np.diff(rates)).max() < 0.1 * speed_m_s, "no jump of the speed"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time_s,x_m\n0,0\n1,1\n", r"has the columns 'time_s,x_m'; give .*time_s,x_m,y_m"),
        ("time_s,x_m,y_m\n0,0,0\n1,here,0\n", "row 3, column 'x_m': 'here' is not a number"),
        ("time_s,x_m,y_m\n0,0,0\n1,0,\n", "row 2 below the header, 1,0,nan: has an empty cell"),
        ("time_s,x_m,y_m\n0,0,0\n2,0,0\n1,0,0\n", "row 3 below .*, 1,0,0: time_s does not rise"),
        ("time_s,x_m,y_m\n0,0,0\n", "has 1 rows"),
        ("time_s,x_m,y_m\n0,0,0\n0.01,0,0\n", r"lasts 0\.01 s"),
        ("time_s,x_m,y_m\n0,0,0\n1,0,-200\n", r"row 2 below .*, 1,0,-200: .*give places in m"),
    ],
)
def test_a_file_that_is_no_path_is_refused_with_its_row(file, text, sentence):
    file.write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_path(file, 2, PERIOD_S)


def test_the_timeline_rests_goes_there_and_comes_back_without_a_jump():
    path = built_in_path("circle", 2, PERIOD_S, PathOptions(size_m=0.2, seconds=3.0))
    rest = np.array([0.005, 0.0])
    line = timeline(path, rest, PERIOD_S)
    assert line.rest_rows == round(REST_S / PERIOD_S)
    still, settle = round((REST_S + LEAD_S) / PERIOD_S), round(SETTLE_S / PERIOD_S)
    for resting in (line.desired_m[:still], line.desired_m[-settle:]):
        assert np.array_equal(resting, np.tile(rest, (len(resting), 1)))
    assert np.array_equal(line.desired_m[line.start_row : line.end_row], path.tip_m)
    acceleration = np.diff(line.desired_m, 2, axis=0) / PERIOD_S**2
    assert np.abs(acceleration).max() < 3.0
