"""Command `dropstitch campaign`: results, a second run, dead workers, interrupts, refusals."""

import csv
import json
import multiprocessing
import os
import select
import signal
import subprocess
import sys
import threading
import time

import pytest

from dropstitch.__main__ import main
from hil.campaign.code_version import ROOT

KIND = 'kind = "tests.hil.campaign.toy_kind"\n'
TOYS = f"""\
name = "Toys"
{KIND}
[grid]
value = [0.0, 1.0, 2.0, 3.0]
act = ["count", "refuse", "raise"]
"""


def campaign(where, text, *options, out="out"):
    path = where / "spec.toml"
    path.write_text(text)
    return main(["campaign", str(path), "--out", str(where / out), *options])


def wait_for_results(out, count):
    while len(list(out.glob("results/*/*.json"))) < count:
        time.sleep(0.02)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Directory of a campaign of toys by processes, and its exit code."""
    where = tmp_path_factory.mktemp("ran")
    text = TOYS.replace('"raise"', '"raise", "die"').replace(", 1.0, 2.0, 3.0", "")
    return where, campaign(where, text, "--workers", "2", "--json"), text


def test_a_campaign_leaves_results_summary_failures_and_a_page(ran):
    where, code, _ = ran
    out = where / "out"
    assert code == 1
    document = json.loads((out / "campaign.json").read_text())
    assert document["states"] == {"done": 1, "failed": 1, "killed": 1, "refused": 1}
    assert document["axes"] == ["value", "act"]
    assert len(list((out / "results").rglob("*.json"))) == 1
    failures = {f["state"]: f for f in document["failures"]}
    assert failures["refused"]["sentence"] == "scratch: cannot be used; take another."
    assert failures["failed"]["sentence"] == "ZeroDivisionError: division of toys"
    for state, words in (("killed", "last words"), ("failed", "about to raise")):
        failure = json.loads((out / f"failures/{failures[state]['example']}-1.json").read_text())
        assert words in failure["log"]
    with (out / "summary.csv").open(newline="") as file:
        summary = list(csv.reader(file))
    assert len(summary) == 5
    assert summary[1][1:] == [
        "done", "", "count", "", "False", "0.0", "[1,2]", "", "0.0",
    ]  # fmt: skip
    with (out / "costs.csv").open(newline="") as file:
        assert len(list(csv.reader(file))) == 1 + 3  # of a worker that died none is measured
    page = (out / "report.html").read_text()
    assert all(words in page for words in ("Campaign: Toys", "1 of 4", "the square", "By act"))


@pytest.mark.slow
def test_dask_gives_the_same_bytes_and_blames_the_same_cases(ran):
    pytest.importorskip("distributed")
    where, _, text = ran
    assert campaign(where, text, "--executor", "dask", "--workers", "2", out="dask") == 1
    for path in ("summary.csv", *(p.relative_to(where / "out") for p in
                                  (where / "out/results").rglob("*.json"))):  # fmt: skip
        assert (where / "dask" / path).read_bytes() == (where / "out" / path).read_bytes()


def test_a_second_run_begins_what_has_no_result_and_nothing_else(tmp_path, capsys):
    assert campaign(tmp_path, TOYS, "--workers", "1") == 1
    results = sorted((tmp_path / "out/results").rglob("*.json"))
    results[0].write_text(results[0].read_text().replace("toy", "tin"))
    before = {path: path.stat().st_mtime_ns for path in results}
    plain = TOYS.replace(', "refuse", "raise"', "")
    assert campaign(tmp_path, plain, "--workers", "1") == 0
    assert "4 of 4 cases have a result, 3 of them before" in capsys.readouterr().out
    changed = [path for path in results if path.stat().st_mtime_ns != before[path]]
    assert changed == [results[0]]


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["processes", "dask"])
def test_workers_killed_from_outside_lose_no_case(tmp_path, executor):
    if executor == "dask":
        pytest.importorskip("distributed")
    text = f'{KIND}[fixed]\nact = "take long"\n[grid]\nvalue = {[float(k) for k in range(12)]}\n'
    others, killed = set(multiprocessing.active_children()), []

    def kill_two():
        for count in (2, 5):
            wait_for_results(tmp_path / "out", count)
            worker = (set(multiprocessing.active_children()) - others).pop()
            os.kill(worker.pid, signal.SIGKILL)
            killed.append(worker.pid)

    killer = threading.Thread(target=kill_two)
    killer.start()
    assert campaign(tmp_path, text, "--executor", executor, "--workers", "2") == 0
    killer.join()
    assert len(set(killed)) == 2
    assert not list((tmp_path / "out/failures").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "executor"),
    [(signal.SIGINT, "dask"), (signal.SIGTERM, "processes"), (signal.SIGKILL, "processes")],
)
def test_a_campaign_that_is_ended_leaves_its_results_and_no_worker(tmp_path, number, executor):
    os.mkfifo(tmp_path / "pipe")
    spec = tmp_path / "spec.toml"
    spec.write_text(f'{KIND}[grid]\nact = ["count", "never end"]\nvalue = [1.0]\n')
    command = [sys.executable, "-m", "dropstitch", "campaign", str(spec), "--workers", "1",
               "--out", str(tmp_path / "out"), "--executor", executor]  # fmt: skip
    process = subprocess.Popen(
        command, env=os.environ | {"TOY_PIPE": str(tmp_path / "pipe")}, cwd=ROOT,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    with open(tmp_path / "pipe", "rb") as pipe:  # waits until the worker has opened it
        wait_for_results(tmp_path / "out", 1)
        if number == signal.SIGINT:  # of a terminal, which reaches the workers too
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        _, printed = process.communicate(timeout=60)
        assert select.select([pipe], [], [], 60)[0] and pipe.read() == b"", "the worker still runs"
    assert process.returncode == {signal.SIGKILL: -9}.get(number, 128 + number)
    assert "Traceback" not in printed
    assert len(list((tmp_path / "out/results").rglob("*.json"))) == 1


@pytest.mark.parametrize(
    ("text", "options", "sentence"),
    [
        (TOYS + "colour = [1]\n", (), "`colour`"),
        (KIND + "[fixed]\nvalue = 'much'\n", (), "case 1 of kind toy"),
        (KIND + "[fixed]\nvalue = nan\n", (), "value is nan"),
        (KIND + "[fixed]\nvalue = -1.0\n", (), "`$.value`"),
        (KIND + "[fixed]\nvalue = 1.0\nfile = '/no/such'\n", (), "/no/such: is missing"),
        ('kind = "rig"\n[grid]\neffects = [{fog = 1.0}]\n', (), "effects.fog"),
        ('kind = "rig"\n[fixed]\npayload_kg = -1.0\n', (), "`$.payload_kg`"),
        ('kind = "sil"\n[fixed]\nbundle = "/no/such"\n', (), "/no/such: is missing"),
        ('kind = "sil"\n[fixed]\nbundle = "."\nfaults = {fog = 1.0}\n', (), "faults.fog"),
        ('kind = "sil"\n[fixed]\nbundle = "."\npressure_pa = 4e4\n', (), 'add rig = "default"'),
        ('kind = "gap"\n[fixed]\nplant = "."\npayloads_kg = []\n', (), "`$.payloads_kg`"),
        (TOYS, ("--workers", "0"), "--workers: is 0"),
        (TOYS, ("--scheduler", "tcp://nowhere:1"), "--executor dask"),
        (TOYS + "[fixed]\nmeasures_time = true\n", (), "add --workers 1"),
        (TOYS + "[fixed]\nmeasures_time = true\n", ("--executor", "dask"), "shared with other"),
    ],
)  # fmt: skip
def test_what_cannot_be_run_is_refused_in_one_sentence(tmp_path, capsys, text, options, sentence):
    assert campaign(tmp_path, text, *options) == 2
    printed = capsys.readouterr().err
    assert sentence in printed
    assert len(printed.splitlines()) == 1


def test_dask_without_its_package_or_its_scheduler_gives_one_sentence(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip("distributed")
    options = ("--executor", "dask", "--scheduler", "tcp://127.0.0.1:9", "--quiet")
    monkeypatch.setattr("hil.campaign.executors.CONNECT_S", 0.3)
    assert campaign(tmp_path, TOYS, *options) == 2
    assert "tcp://127.0.0.1:9: does not answer" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert campaign(tmp_path, TOYS, *options) == 2
    assert "pip install 'dropstitch[dask]'" in capsys.readouterr().err


def test_a_full_disk_ends_the_campaign_and_its_workers(tmp_path, capsys, monkeypatch):
    def full(path, data):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("hil.campaign.store.write_whole", full)
    others = set(multiprocessing.active_children())
    assert campaign(tmp_path, TOYS, "--workers", "1") == 2
    assert "No space left on device" in capsys.readouterr().err
    assert set(multiprocessing.active_children()) <= others
