"""Command `dropstitch campaign`: results, a second run, plans, and what is refused."""

import csv
import json
import os
import stat
import sys

import pytest

from dropstitch.__main__ import main

TOYS = """\
name = "Toys"
kind = "tests.hil.campaign.toy_kind"
[grid]
value = [0.0, 1.0, 2.0, 3.0]
act = ["count", "refuse"]
"""


def campaign(tmp_path, text, *options):
    path = tmp_path / "spec.toml"
    path.write_text(text)
    return main(["campaign", str(path), "--out", str(tmp_path / "out"), *options])


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Directory of a campaign of toys with one worker, and its exit code."""
    where = tmp_path_factory.mktemp("ran")
    return where, campaign(where, TOYS, "--workers", "1", "--json")


def test_a_campaign_leaves_results_summary_failures_and_a_page(ran):
    where, code = ran
    assert code == 1  # half of the cases were refused
    out = where / "out"
    document = json.loads((out / "campaign.json").read_text())
    assert document["states"] == {"done": 4, "refused": 4}
    assert document["axes"] == ["value", "act"]
    (failure,) = document["failures"]
    assert (failure["cases"], failure["sentence"][:8]) == (4, "scratch:")
    assert len(list((out / "results").rglob("*.json"))) == 4
    assert len(list((out / "failures").glob("*.json"))) == 4
    with (out / "summary.csv").open(newline="") as file:
        summary = list(csv.reader(file))
    assert len(summary) == 9
    assert summary[7][1:] == [
        "done", "", "count", "", "False", "3.0", "[1,2]", "", "9.0",
    ]  # fmt: skip
    page = (out / "report.html").read_text()
    for words in ("Campaign: Toys", "4 of 8", "the square", "By value", "cannot be used"):
        assert words in page


def test_a_second_run_keeps_what_is_there(ran, capsys):
    where, _ = ran
    kept = {p: p.stat().st_mtime_ns for p in (where / "out" / "results").rglob("*.json")}
    plain = TOYS.replace('"count", "refuse"', '"count"')
    assert campaign(where, plain, "--workers", "1") == 0
    assert "4 of 4 cases have a result, 4 of them before" in capsys.readouterr().out
    assert {p: p.stat().st_mtime_ns for p in kept} == kept


def test_other_code_is_told_and_does_not_count(ran, capsys, monkeypatch):
    where, _ = ran
    monkeypatch.setattr("hil.campaign.campaign_cases.code_version", lambda rooms: "other code")
    one = TOYS.replace("[0.0, 1.0, 2.0, 3.0]", "[0.0]").replace('"count", "refuse"', '"count"')
    assert campaign(where, one, "--workers", "1") == 1  # the worker has the code as it is
    told = capsys.readouterr()
    assert "the code has changed since the last run" in told.err
    assert "the campaign has other code" in told.out


def test_a_plan_follows_from_cases_that_ran(ran, capsys):
    where, _ = ran
    options = ("--dry-run", "--cases", "1000", "100000", "--workers", "50", "--json")
    assert campaign(where, TOYS, *options) == 0
    few, many = json.loads(capsys.readouterr().out)["plans"]
    assert (few["cases"], many["cases"], few["workers"]) == (1000, 100_000, 50)
    assert many["disk_bytes"] == 100 * few["disk_bytes"]
    assert many["disk_bytes"] > 100_000 * many["result_bytes"]
    assert many["workers_bytes"] == 50 * many["worker_bytes"]
    assert (many["cpu_hours"] - few["cpu_hours"]) / (few["cpu_hours"]) > 90 or few["start_s"] > 0
    assert "--workers 50" in few["command"]
    assert few["command"].startswith("dropstitch campaign ")


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("kind = 'nothing'\n", (), "kind 'nothing': is not known"),
        ("kind = 'no.such.kind'\n", (), "cannot be imported"),
        (TOYS + "colour = [1]\n", (), "unknown field `colour`"),
        ('kind = "rig"\n[grid]\neffects = [{fog = 1.0}]\n', (), "effects.fog: is no effect"),
        ('kind = "rig"\n[fixed]\npayload_kg = -1.0\n', (), "payload_kg: is -1; choose 0 to 10"),
        ('kind = "sil"\n[fixed]\nbundle = "/no/such"\n', (), "/no/such: is missing"),
        ('kind = "sil"\n[fixed]\nbundle = "."\nfaults = {fog = 1.0}\n', (), "faults.fog"),
        ('kind = "sil"\n[fixed]\nbundle = "."\npressure_pa = 4e4\n', (), 'add rig = "default"'),
        ('kind = "gap"\n[fixed]\nplant = "."\npayloads_kg = []\n', (), "payloads_kg: is empty"),
        ('kind = "fmu"\n[fixed]\nfmu = "."\nstep_s = 2.0\n', (), "step_s: is 2"),
        (TOYS, ("--workers", "0"), "--workers: is 0"),
        (TOYS, ("--executor", "dask"), "add --scheduler"),
        (TOYS, ("--scheduler", "tcp://nowhere:1"), "is of --executor dask"),
        (TOYS, ("--cases", "5"), "is for --dry-run"),
        (TOYS + "[fixed]\nmeasures_time = true\n", (), "add --workers 1"),
        (TOYS + "[fixed]\nmeasures_time = true\n",
         ("--executor", "submitit", "--cluster", "local"), "shared with other programs"),
        (TOYS, ("--executor", "submitit", "--cluster", "moon"), "cannot be set up"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_sentence(tmp_path, capsys, text, options, said):
    assert campaign(tmp_path, text, *options) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("extra", ["dask", "submitit"])
def test_a_missing_extra_gives_the_remedy(tmp_path, capsys, monkeypatch, extra):
    monkeypatch.setitem(sys.modules, {"dask": "distributed"}.get(extra, extra), None)
    options = ("--executor", extra) + (("--scheduler", "tcp://a:1") if extra == "dask" else ())
    assert campaign(tmp_path, TOYS, *options) == 2
    assert f"pip install 'dropstitch[{extra}]'" in capsys.readouterr().err


def test_a_scheduler_that_does_not_answer_gives_one_sentence(tmp_path, capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("hil.campaign.engines.dask_engine.CONNECT_S", 0.3)
    options = ("--executor", "dask", "--scheduler", "tcp://127.0.0.1:9")
    assert campaign(tmp_path, TOYS, *options) == 2
    assert "tcp://127.0.0.1:9: does not answer" in capsys.readouterr().err


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_directory_that_cannot_be_written_gives_one_sentence(tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out").chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert campaign(tmp_path, TOYS) == 2
    assert "name another --out" in capsys.readouterr().err


def test_an_out_that_is_a_file_gives_one_sentence(tmp_path, capsys):
    (tmp_path / "out").write_text("")
    assert campaign(tmp_path, TOYS) == 2
    assert "cannot be made a directory" in capsys.readouterr().err


def test_a_full_disk_ends_the_campaign_and_its_workers(tmp_path, capsys, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device", str(tmp_path / "out"))

    monkeypatch.setattr("hil.campaign.result_store._write_whole", full)
    assert campaign(tmp_path, TOYS, "--workers", "1") == 2
    assert "No space left on device" in capsys.readouterr().err
