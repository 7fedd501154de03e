"""Engines: the same bytes from each, dead workers, cases that kill."""

from __future__ import annotations

import contextlib
import json
import os
import random
import select
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from firmware_py.core.errors import InputError
from hil.campaign.campaign_run import run_campaign_cases
from hil.campaign.campaign_summary import write_summary
from hil.campaign.case_task import CaseTask, TaskOutcome
from hil.campaign.engines.process_engine import ProcessEngine

ACTS = {3: "refuse", 5: "raise", 7: "die"}
CASES = 24


def configurations(*without):
    cases = [{"value": float(k), "act": ACTS.get(k, "count")} for k in range(CASES)]
    return [case for case in cases if case["act"] not in without]


def summary(campaign):
    path = campaign.out / "summary.csv"
    write_summary(campaign.cases, campaign.store, path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def by_processes(toys):
    campaign = toys("processes", configurations())
    engine = ProcessEngine(2, campaign.out / "logs")
    counts = run_campaign_cases(campaign.cases, campaign.maker, campaign.store, engine)
    return campaign, counts


def test_processes_keep_every_outcome_and_blame_the_killer_alone(by_processes):
    campaign, counts = by_processes
    assert counts.ran == {"done": CASES - 3, "refused": 1, "failed": 1, "killed": 1}
    rows = summary(campaign).decode().splitlines()
    assert len(rows) == CASES + 1
    for k, (state, sentence) in {
        3: ("refused", "scratch: cannot be used; take another."),
        5: ("failed", "ZeroDivisionError: division of toys"),
        7: ("killed", "its worker died each time that it was begun"),
    }.items():
        assert rows[k + 1].split(",")[1:3] == [state, sentence]
    failure = campaign.store.last_failure(campaign.cases[7].key)
    assert "ended with code 7" in failure.log
    assert "last words" in failure.log
    raised = campaign.store.last_failure(campaign.cases[5].key)
    assert "about to raise" in raised.log
    assert 'raise ZeroDivisionError("division of toys")' in raised.log
    costs = campaign.store.read_costs()
    assert len(costs) == CASES - 1  # nobody measured what died
    assert json.loads(costs[0]["parts_s"]) == {"thinking": 0.25}


def test_a_second_run_begins_what_has_no_result_and_nothing_else(by_processes):
    campaign, _ = by_processes
    before = {c.key: campaign.store.path(c.key).stat().st_mtime_ns for c in campaign.cases[8:]}
    campaign.store.path(campaign.cases[0].key).write_text("{}")
    chosen = [c for k, c in enumerate(campaign.cases) if k != 7]
    engine = ProcessEngine(1, campaign.out / "logs")
    counts = run_campaign_cases(chosen, campaign.maker, campaign.store, engine)
    assert (counts.kept, counts.damaged) == (CASES - 4, 1)
    assert counts.ran == {"done": 1, "refused": 1, "failed": 1}
    after = {c.key: campaign.store.path(c.key).stat().st_mtime_ns for c in campaign.cases[8:]}
    assert after == before


CAMPAIGN = """
import sys
from pathlib import Path
from hil.campaign.campaign_cases import CaseMaker
from hil.campaign.campaign_run import run_campaign_cases
from hil.campaign.engines.process_engine import ProcessEngine
from hil.campaign.result_store import ResultStore
from tests.hil.campaign.toy_kind import KIND
out = Path(sys.argv[1])
maker = CaseMaker(KIND, "tests.hil.campaign.toy_kind", out / "shared")
cases = maker.cases([{"value": 1.0, "act": "never end"}], "toys.toml")
run_campaign_cases(cases, maker, ResultStore(out), ProcessEngine(1, out / "logs"))
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_a_campaign_that_is_ended(tmp_path, number):
    os.mkfifo(tmp_path / "pipe")
    campaign = subprocess.Popen(
        [sys.executable, "-c", CAMPAIGN, str(tmp_path)],
        env=os.environ | {"TOY_PIPE": str(tmp_path / "pipe")}, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    with open(tmp_path / "pipe", "rb") as pipe:  # waits until the worker has opened it
        campaign.send_signal(number)
        campaign.wait(timeout=60)
        assert select.select([pipe], [], [], 60)[0] and pipe.read() == b"", "the worker still runs"


class KillingEngine:
    """Engine of dask, with workers of its cluster killed at random moments."""

    shared = True

    def __init__(self, engine, cluster, moments):
        self.engine, self.cluster, self.moments = engine, cluster, set(moments)
        self.random, self.kills = random.Random(1), 0

    def outcomes(self, tasks):
        for number, outcome in enumerate(self.engine.outcomes(tasks)):
            if number in self.moments:
                self.kill()
            yield outcome

    def kill(self):
        while True:
            nanny = self.random.choice(list(self.cluster.workers.values()))
            pid = nanny.pid
            if nanny.status.name == "running" and pid:  # one that dies while it starts stays dead
                with contextlib.suppress(ProcessLookupError):  # gone, and its nanny not aware of it
                    os.kill(pid, signal.SIGKILL)
                    self.kills += 1
                    return
            time.sleep(0.02)


@pytest.fixture
def cluster():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as made:
        made.scheduler.allowed_failures = 0  # whoever is assigned to a dead worker is suspected
        yield made


def test_a_dask_cluster_with_workers_killed_at_random_gives_the_same_bytes(
    toys, by_processes, cluster
):
    from hil.campaign.engines.dask_engine import DaskEngine

    twin = by_processes[0]
    campaign = toys("dask", configurations("die"))  # a nanny may not come back from that
    engine = KillingEngine(
        DaskEngine(cluster.scheduler_address), cluster, random.Random(0).sample(range(8), 2)
    )
    counts = run_campaign_cases(campaign.cases, campaign.maker, campaign.store, engine)
    assert engine.kills == 2
    assert counts.ran == {"done": CASES - 3, "refused": 1, "failed": 1}
    expected = [row for row in summary(twin).splitlines() if b",killed," not in row]
    assert summary(campaign).splitlines() == expected
    for case in campaign.cases:
        if (path := campaign.store.path(case.key)).exists():
            assert path.read_bytes() == twin.store.path(case.key).read_bytes()


class FakeFuture(SimpleNamespace):
    """Future of dask, as far as the engine asks; a key of dictionaries."""

    __hash__ = object.__hash__


class FakeClient:
    """Client whose cluster gives up the cases of some keys as often as it is told."""

    status = "running"

    def __init__(self, gives_up):
        self.gives_up, self.begun = gives_up, []

    def ncores(self):
        return {"a": 1}

    def submit(self, run, task, **options):
        self.begun.append(task.key)
        bad = self.begun.count(task.key) <= self.gives_up.get(task.key, 0)
        outcome = TaskOutcome(key=task.key, state="done")
        future = FakeFuture(
            status="error" if bad else "finished",
            result=lambda timeout: outcome,
            exception=lambda timeout: MemoryError("of a worker"),
            release=lambda: None,
        )
        future.add_done_callback = lambda call: call(future)
        return future


def test_a_case_that_dask_gives_up_is_run_once_more_alone():
    from hil.campaign.engines.dask_engine import _DaskRun

    tasks = [CaseTask(key=k, kind="", config="", files={}, code="") for k in "abcdefgh"]
    client = FakeClient({"b": 1, "d": 2})
    run = _DaskRun(SimpleNamespace(KilledWorker=MemoryError), client, "here", tasks)
    states = {outcome.key: outcome.state for outcome in run.outcomes()}
    assert states == {k: "killed" if k == "d" else "done" for k in "abcdefgh"}
    assert client.begun == [*"abcdefgh", "b", "d"]


def test_submitit_gives_the_same_bytes(toys, by_processes, monkeypatch):
    pytest.importorskip("submitit")
    from hil.campaign.engines import submitit_engine
    from hil.campaign.engines.submitit_engine import SubmititEngine

    monkeypatch.setattr(submitit_engine, "JOBS_PER_WORKER", 1)
    monkeypatch.setattr(submitit_engine, "ATTEMPTS", 2)

    chosen = configurations()[:8]
    campaign, twin = toys("submitit", chosen), by_processes[0]
    engine = SubmititEngine(1, campaign.out / "submitit", "local", {})
    counts = run_campaign_cases(campaign.cases, campaign.maker, campaign.store, engine)
    assert counts.ran == {"done": 5, "refused": 1, "failed": 1, "killed": 1}
    assert summary(campaign).splitlines() == summary(twin).splitlines()[:9]


def test_no_engine_of_a_cluster_measures_time(toys):
    class Shared:
        shared = True

    campaign = toys("out", [{"value": 1.0, "measures_time": True}])
    with pytest.raises(InputError, match="shared with other programs"):
        run_campaign_cases(campaign.cases, campaign.maker, campaign.store, Shared())


def test_a_worker_with_other_code_or_files_refuses(toys, tmp_path):
    from hil.campaign.case_worker import run_task

    path = tmp_path / "file"
    path.write_text("as it was")
    campaign = toys("out", [{"value": 1.0, "file": str(path)}])
    task = campaign.maker.task(campaign.cases[0])
    assert run_task(task).state == "done"
    other = type(task)(**{n: getattr(task, n) for n in task.__struct_fields__} | {"code": "old"})
    assert "the campaign has old" in run_task(other).sentence
    gone = type(task)(
        **{n: getattr(task, n) for n in task.__struct_fields__} | {"files": {"/no/such": "0"}}
    )
    assert "/no/such: is missing on the worker" in run_task(gone).sentence
    changed = type(task)(
        **{n: getattr(task, n) for n in task.__struct_fields__} | {"files": {str(path): "0"}}
    )
    assert "differs on the worker" in run_task(changed).sentence
