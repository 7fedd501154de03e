"""Recorded runs: the code of today gives goals, states and ends of then, or it is declared."""

import lzma
import tomllib
from pathlib import Path

import msgspec
import pytest

from firmware_py.core.errors import InputError
from firmware_py.safety import blend, supervisor
from hil.faults.fault_table import ROWS
from hil.faults.recorded.recorded_run import read_runs
from hil.faults.recorded.run_replay import replay_run

HERE = Path(__file__).parent
FILE = HERE / "recorded_runs.xz"
RUNS = {run.facts.name: run for run in read_runs(FILE)}
DECLARED = tomllib.loads((HERE / "declared.toml").read_text(encoding="utf-8"))["changed"]


@pytest.mark.parametrize("name", RUNS)
def test_a_recorded_run_is_answered_as_it_was(name):
    difference = replay_run(RUNS[name])
    if name in DECLARED:
        assert difference, "the declaration in declared.toml is out of date"
    else:
        assert not difference, f"{difference}; mend it, or declare it in declared.toml"


def test_what_is_declared_was_recorded_and_has_a_reason():
    assert set(DECLARED) <= set(RUNS)
    assert all(isinstance(reason, str) and len(reason) > 10 for reason in DECLARED.values())


def test_every_fault_of_the_virtual_line_that_lets_the_robot_start_was_recorded():
    recorded = {name.rpartition(" (virtual")[0] for name in RUNS}
    started = {
        f"{row.fault}, {row.how}"
        for row in ROWS
        if "virtual" in row.lines
        and row.must.ended != "refused"
        and row.setup.feedback == "none"  # its interval and innovation are not on the tape
        and not row.setup.outside  # nor are the messages of a program
    }
    assert recorded == started


def run_named(part):
    return next(run for name, run in RUNS.items() if part in name)


def test_a_limit_that_is_wider_is_found_out():
    run = run_named("current spike of 12 A, three in a row")
    facts = run.facts
    limits = msgspec.structs.replace(facts.config.limits, current_a=15.0)
    config = msgspec.structs.replace(facts.config, limits=limits)
    changed = type(run)(msgspec.structs.replace(facts, config=config), run.columns)
    assert replay_run(run) == "" and replay_run(changed)


def test_a_supervisor_that_forgives_one_stale_tick_more_is_found_out(monkeypatch):
    plain = supervisor.SafetySupervisor.check

    def lenient(self, status, *rest):
        if self.stale_ticks == 2 and not status.fresh:
            status = type(status).OK
        plain(self, status, *rest)

    monkeypatch.setattr(supervisor.SafetySupervisor, "check", lenient)
    assert "goes on" in replay_run(run_named("lost reply, both reads of three ticks"))


def test_goals_that_are_blended_otherwise_are_found_out(monkeypatch):
    plain = blend.Blend.next
    monkeypatch.setattr(
        blend.Blend, "next", lambda self, desired: [1.001 * goal for goal in plain(self, desired)]
    )
    assert "goal_1_rad of row" in replay_run(run_named("arm leans at the start, by 20°"))


@pytest.mark.parametrize("content", [b"", b"text", lzma.compress(b"text")])
def test_a_damaged_file_of_runs_is_refused(tmp_path, content):
    (tmp_path / "runs.xz").write_bytes(content)
    with pytest.raises(InputError, match="holds no recorded runs"):
        read_runs(tmp_path / "runs.xz")
