"""Claims: the table, the commands it names, the runs, and the documents drawn from the results."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

from bench.claims import __main__ as command
from bench.claims import claim_docs, claim_table
from bench.claims.claim_docs import documents, marked_groups, redraw_tables
from bench.claims.claim_page import write_claims_page
from bench.claims.claim_runs import chosen_claims, figure_in, measure_claims
from bench.claims.claim_table import (
    ROOT,
    Claim,
    ClaimFigure,
    read_accepted,
    read_claims,
    read_titles,
)
from firmware_py.errors import InputError

CLAIMS = read_claims()
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def claim(**fields):
    needed = {
        "name": "a",
        "group": "g",
        "what": "w",
        "stated_in": [],
        "command": "c",
        "value": "/v",
    }
    return Claim(**(needed | fields))


def ignored(name):
    pass


@pytest.mark.parametrize("own", CLAIMS, ids=lambda c: c.name)
def test_a_claim_names_documents_that_draw_it(own):
    assert own.stated_in
    for name in own.stated_in:
        assert own.group in marked_groups((ROOT / name).read_text(encoding="utf-8")), name


@pytest.mark.parametrize("text", sorted({c.command for c in CLAIMS}))
def test_a_claim_names_commands_that_exist(text):
    for part in text.replace(">&2", "").split("&&"):
        words = [w for w in part.split() if not re.match(r"[A-Z]+=", w)]
        if words[0] == "make":
            assert all(is_made(target) for target in words[1:]), part
        else:
            assert words[:2] == ["python", "-m"] and importlib.util.find_spec(words[2]), part


def is_made(target):
    """Whether the Makefile has a rule for a target."""
    rules = re.findall(r"^([^\s:#=][^:=]*):(?!=)", MAKEFILE, re.MULTILINE)
    names = [n.replace("$(GAP)", "build/gap_demo/%") for rule in rules for n in rule.split()]
    patterns = [re.escape(n).replace("%", ".+") for n in names]
    return any(re.fullmatch(p, target) for p in patterns)


def test_every_accepted_figure_has_a_claim():
    assert set(read_accepted()) <= {c.name for c in CLAIMS}


@pytest.mark.parametrize("path", documents(), ids=lambda p: p.name)
def test_the_tables_of_a_document_are_those_of_the_accepted_figures(path):
    text = path.read_text(encoding="utf-8")
    assert set(marked_groups(text)) <= {claim_docs.HEADLINE, *(c.group for c in CLAIMS)}
    assert redraw_tables(text, CLAIMS, read_accepted()) == text, "run python -m bench.claims --draw"
    assert text.count("<!-- claims: ") == len(marked_groups(text)) == text.count("<!-- /claims -->")


def test_a_changed_figure_and_a_row_without_a_claim_are_found():
    own = claim(unit="mm", at_most=2.0)
    text = "<!-- claims: g -->\n<!-- /claims -->\n"
    drawn = redraw_tables(text, [own], {"a": ClaimFigure(value=1.5, on="2026-01-02")})
    assert "| w | 1.50 mm | ≤ 2 mm | 2026-01-02 |" in drawn
    assert redraw_tables(drawn, [own], {"a": ClaimFigure(value=1.6, on="2026-01-02")}) != drawn
    longer = drawn.replace("<!-- /claims -->", "| x | 1 | | |\n<!-- /claims -->")
    assert redraw_tables(longer, [own], {"a": ClaimFigure(value=1.5, on="2026-01-02")}) == drawn


@pytest.mark.parametrize(
    ("target", "value", "met"),
    [
        ({"at_most": 2.0}, 2.0, True), ({"at_most": 2.0}, 2.001, False),
        ({"at_least": 2.0}, 2.0, True), ({"at_least": 2.0}, 1.999, False),
        ({"equal_to": 2.0, "within": 0.5}, 1.5, True),
        ({"equal_to": 2.0, "within": 0.5}, 2.6, False), ({}, 7.0, None),
    ],
)  # fmt: skip
def test_a_target_holds_up_to_its_limit(target, value, met):
    assert claim(**target).is_met(value) is met


def test_a_value_is_read_scaled_and_divided():
    data = {"fits": [{"rms": 0.003, "of": 7, "interval": [0.002, 0.004]}], "base": 2.0}
    own = claim(value="/fits/0/rms", over="/base", factor=1e3, of="/fits/0/of",
                interval="/fits/0/interval")  # fmt: skip
    figure = figure_in(own, data)
    assert (figure.value, figure.of, figure.interval) == (1.5, 7, (2.0, 4.0))


def test_claims_of_one_command_share_its_run_and_a_missing_value_is_a_miss(tmp_path):
    runs = []

    def run(text):
        runs.append(text)
        return json.dumps({"v": 3.0, "none": None}), 60.0

    (tmp_path / "left.json").write_text('{"v": 4.0}')
    chosen = [
        claim(), claim(name="b", at_least=3.5), claim(name="d", value="/other"),
        claim(name="e", result="left.json"), claim(name="f", result="nowhere.json"),
        claim(name="n", value="/none"),
        claim(name="t", result="time", value="/seconds", factor=1 / 60),
    ]  # fmt: skip
    measured = {m.claim.name: m for m in measure_claims(chosen, ignored, run, tmp_path)}
    assert runs == ["c"]
    assert [m.met for m in measured.values()] == [None, False, False, None, False, False, None]
    assert measured["e"].figure.value == 4.0 and measured["t"].figure.value == 1.0
    assert "KeyError" in measured["d"].problem
    assert "the result holds no figure at /none" in measured["n"].problem
    text = command.claims_text(list(measured.values()))
    assert text.count("MISSED") == 4 and "no value" in text


def test_long_claims_are_measured_only_where_they_are_named():
    short, long = claim(minutes=1.0), claim(name="b", group="long", minutes=100.0)
    assert chosen_claims([short, long], []) == [short]
    assert chosen_claims([short, long], ["lo*"]) == [long]
    assert chosen_claims([short, long], ["a", "b"]) == [short, long]


def test_the_command_measures_accepts_and_fails_on_a_missed_target(tmp_path, monkeypatch, capsys):
    table, accepted = tmp_path / "claims.toml", tmp_path / "claims.json"
    table.write_text(
        '[titles]\ng = "Group"\n[[claim]]\nname = "a"\ngroup = "g"\nwhat = "w"\nstated_in = []\n'
        'command = "echo \'{\\"v\\": 2}\'"\nvalue = "/v"\nat_most = 1.0\n'
    )
    monkeypatch.setattr(command, "read_claims", lambda: read_claims(table))
    monkeypatch.setattr(command, "read_titles", lambda: read_titles(table))
    monkeypatch.setattr(command, "read_accepted", lambda: read_accepted(accepted))
    monkeypatch.setattr(command, "ACCEPTED", accepted)
    monkeypatch.setattr(command, "_draw", lambda: 0)
    assert command.main(["--accept", "--out", str(tmp_path / "build")]) == 1
    assert capsys.readouterr().out.startswith("MISSED a")
    assert read_accepted(accepted)["a"].value == 2.0
    page = (tmp_path / "build" / "claims.html").read_text()
    assert "<svg" in page and "missed" in page
    assert command.main(["--only", "nobody"]) == 2


def test_a_table_that_is_ambiguous_is_refused(tmp_path):
    path = tmp_path / "claims.toml"
    fields = ('name = "a"', 'group = "g"', 'what = "w"', "stated_in = []", 'command = "c"')
    one = "\n".join(["[[claim]]", *fields, 'value = "/v"', ""])
    for text in (
        one,
        f'[titles]\ng = "G"\n{one}{one}',
        f'[titles]\ng = "G"\n{one}at_most = 1\nat_least = 1\n',
    ):
        path.write_text(text)
        with pytest.raises(InputError):
            read_claims(path)


def test_the_page_shows_every_figure_beside_its_target(tmp_path):
    measured = measure_claims([claim(at_most=4.0)], ignored, lambda text: ('{"v": 3}', 1.0), Path())
    page = write_claims_page(measured, {"g": "Group"}, tmp_path / "claims.html").read_text()
    assert "3.00" in page and "≤ 4" in page and "1 of 1 targets" in page
    assert claim_docs.figure_table([claim()], {}).count("not measured") == 1
    assert claim_table.TABLE.exists()
