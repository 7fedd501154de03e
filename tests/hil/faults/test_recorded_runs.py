"""Recorded runs: today's code gives the same goals, states and ends, or the change is declared."""

import tomllib

import pytest

from firmware_py.safety import blend, supervisor
from hil.faults import virtual_case
from hil.faults.fault_table import ROWS
from hil.faults.faults_document import FaultCase
from tests.hil.faults.recorded_runs import (
    FILE,
    read_runs,
    record_case,
    replay_run,
    replayable,
    write_runs,
)
from tests.hil.faults.toy_robot import ToyPhysics, toy_robot

RUNS = {run.name: run for run in read_runs(FILE)}
DECLARED = tomllib.loads(FILE.with_name("declared.toml").read_text(encoding="utf-8"))["changed"]


@pytest.mark.parametrize("name", RUNS)
def test_a_recorded_run_is_replayed_without_a_difference_unless_it_is_declared(name):
    difference = replay_run(RUNS[name])
    if name in DECLARED:
        assert difference, "the declaration in declared.toml is out of date"
    else:
        assert not difference, f"{difference}; mend it, or declare it in declared.toml"


def test_every_row_of_the_virtual_line_that_lets_the_robot_start_was_recorded():
    rows = {f"{row.fault}, {row.how}" for row in ROWS if replayable(row)}
    assert {run.row for run in RUNS.values()} == rows, (
        "run python -m tests.hil.faults.recorded_runs"
    )


def test_a_new_recording_is_replayed_and_read_back(monkeypatch, tmp_path):
    monkeypatch.setattr(virtual_case, "FmuPhysics", ToyPhysics)
    row = next(row for row in ROWS if replayable(row) and row.injects("port"))
    run = record_case(FaultCase(row, "virtual", row.models[0], 1), toy_robot(tmp_path))
    assert replay_run(run) == ""
    write_runs(tmp_path / "runs.xz", [run])
    assert replay_run(read_runs(tmp_path / "runs.xz")[0]) == ""


def run_named(part):
    return next(run for name, run in RUNS.items() if part in name)


def test_a_supervisor_that_tolerates_one_stale_tick_more_makes_a_difference(monkeypatch):
    plain = supervisor.SafetySupervisor.check

    def lenient(self, status, *rest):
        if self.stale_ticks == 2 and not status.fresh:
            status = type(status).OK
        plain(self, status, *rest)

    monkeypatch.setattr(supervisor.SafetySupervisor, "check", lenient)
    assert "goes on" in replay_run(run_named("lost reply, both reads of three ticks"))


def test_goals_that_are_blended_otherwise_make_a_difference(monkeypatch):
    plain = blend.Blend.next
    monkeypatch.setattr(
        blend.Blend, "next", lambda self, desired: [1.001 * goal for goal in plain(self, desired)]
    )
    assert "goal_1_rad of row" in replay_run(run_named("arm leans at the start, by 20°"))
