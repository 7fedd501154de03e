"""File of a campaign: grids, draws, and what is refused."""

import re

import pytest

from firmware_py.core.errors import InputError
from hil.campaign.specification import configurations, read_spec


@pytest.fixture
def spec_of(tmp_path):
    def read(text):
        path = tmp_path / "spec.toml"
        path.write_text('kind = "rig"\n' + text)
        return read_spec(path)

    return read


def test_a_grid_makes_every_combination_the_last_axis_fastest(spec_of):
    spec = spec_of(
        "[fixed]\ndof = 2\n[grid]\npayload_kg = [0.0, 2.0]\nseed = {first = 5, count = 2}\n"
        "[grid.effects]\nbacklash = [0.0, 0.01]\n"
    )
    made = list(configurations(spec))
    assert len(made) == 8
    assert made[0] == {"dof": 2, "payload_kg": 0.0, "seed": 5, "effects": {"backlash": 0.0}}
    assert made[1]["effects"] == {"backlash": 0.01}
    assert made[-1] == {"dof": 2, "payload_kg": 2.0, "seed": 6, "effects": {"backlash": 0.01}}


def test_more_draws_hold_the_cases_of_fewer(spec_of):
    text = (
        "draws = {}\ndraw_seed = 3\n[draw]\npayload_kg = {{uniform = [0.5, 1.5]}}\n"
        "seed = {{integers = [1, 3]}}\n[draw.effects]\ncreep = {{log_uniform = [0.01, 1.0]}}\n"
    )
    few, many = (list(configurations(spec_of(text.format(n)))) for n in (20, 50))
    assert many[:20] == few
    assert all(0.5 <= c["payload_kg"] <= 1.5 for c in many)
    assert {c["seed"] for c in many} == {1, 2, 3}
    creep = [c["effects"]["creep"] for c in many]
    assert min(creep) < 0.1 < max(creep)
    assert len({c["payload_kg"] for c in many}) == 50


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[grid]\npayload_kg = []\n", "axis payload_kg of [grid] is empty"),
        ("[grid]\npayload_kg = 1.0\n", "is no list"),
        ("[grid]\nseed = {first = 0, count = 0}\n", "count ≥ 1"),
        ("[grid]\nseed = {first = 0, count = 2000000}\n", "too large a first or count"),
        ("draws = 1000001\n[draw]\nseed = {integers = [0, 5]}\n", "more than 1000000 cases"),
        (f"draws = 5\n[draw]\nseed = {{integers = [0, {2**63}]}}\n", "beyond 64 bits"),
        ("draws = 5\n[draw]\npayload_kg = {uniform = [-1e308, 1e308]}\n", "too far apart"),
        ("[fixed]\na = [{b = 1}]\n[grid]\na.0.b = [1]\n", "set the same value"),
        ("draws = 5\n", "draws = 5 without a table [draw]"),
        ("[draw]\nseed = {integers = [0, 5]}\n", "no number of draws"),
        ("draws = 5\n[draw]\npayload_kg = {log_uniform = [0, 5]}\n", "the lower one positive"),
        ("draws = 5\n[draw]\npayload_kg = {uniform = [5, 0]}\n", "rising"),
        ("draws = 5\n[draw]\npayload_kg = {normal = [5, 1]}\n", "needs one of uniform"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_in_one_sentence(spec_of, text, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        spec_of(text)
