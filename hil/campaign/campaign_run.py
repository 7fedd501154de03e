"""Run of a campaign: an engine runs the cases without a result, the store keeps the outcomes."""

from __future__ import annotations

import contextlib
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, overload

from firmware_py.core.console import Progress, terminations_raised
from firmware_py.core.errors import InputError
from hil.campaign.campaign_cases import CampaignCase, CaseMaker
from hil.campaign.case_task import CaseTask
from hil.campaign.engines.engine import Engine
from hil.campaign.result_store import ResultStore

ONE_THREAD: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that limit numerical libraries to one thread per worker."""


@dataclass(frozen=True)
class RunCounts:
    """Counts of a run."""

    cases: int
    kept: int  # Valid results of an earlier run with this code
    damaged: int  # Damaged result files; their cases ran again
    ran: dict[str, int]  # Cases that ran, by outcome


class LazyTasks(Sequence[CaseTask]):
    """Tasks of cases, each made when an engine needs it."""

    def __init__(self, maker: CaseMaker, cases: Sequence[CampaignCase]) -> None:
        self._maker, self._cases = maker, cases

    def __len__(self) -> int:
        return len(self._cases)

    @overload
    def __getitem__(self, place: int) -> CaseTask: ...

    @overload
    def __getitem__(self, place: slice) -> list[CaseTask]: ...

    def __getitem__(self, place: int | slice) -> CaseTask | list[CaseTask]:
        if isinstance(place, slice):
            return [self._maker.task(case) for case in self._cases[place]]
        return self._maker.task(self._cases[place])


def missing_cases(
    cases: Sequence[CampaignCase], store: ResultStore
) -> tuple[list[CampaignCase], int]:
    """Return the cases without a valid result, and how many of them have a damaged one."""
    left = [case for case in cases if store.read(case.key) is None]
    return left, sum(store.path(case.key).exists() for case in left)


def check_engine(cases: Sequence[CampaignCase], maker: CaseMaker, engine: Engine) -> None:
    """Refuse real-time cases on an engine whose processors other programs may use."""
    if engine.shared and any(maker.kind.in_real_time(case.config) for case in cases):
        raise InputError(
            "line", "keeps real time, and workers of a cluster are shared with other programs",
            'set line = "virtual", or take --executor processes --workers 1',
        )  # fmt: skip


def run_campaign_cases(
    cases: Sequence[CampaignCase], maker: CaseMaker, store: ResultStore, engine: Engine
) -> RunCounts:
    """Run the cases without a valid result; store each outcome as soon as it arrives."""
    check_engine(cases, maker, engine)
    left, damaged = missing_cases(cases, store)
    if damaged:
        print(f"{damaged} results are damaged and run again", file=sys.stderr)
    ran: Counter[str] = Counter()
    if left:
        ran = _run_missing(left, maker, store, engine)
    return RunCounts(len(cases), len(cases) - len(left), damaged, dict(ran))


def _run_missing(
    left: Sequence[CampaignCase], maker: CaseMaker, store: ResultStore, engine: Engine
) -> Counter[str]:
    by_key = {case.key: case for case in left}
    ran: Counter[str] = Counter()
    progress = Progress("campaign", len(left))
    with terminations_raised(), _one_thread():
        outcomes = engine.outcomes(LazyTasks(maker, left))
        with contextlib.closing(outcomes):  # type: ignore[type-var]
            for outcome in outcomes:
                case, size = by_key[outcome.key], 0
                if outcome.state == "done":
                    size = store.write(
                        case.key, maker.kind.name, maker.code, case.config, outcome.result
                    )
                else:
                    store.write_failure(maker.kind.name, maker.code, case.config, outcome)
                store.add_cost(maker.code, outcome, size)
                ran[outcome.state] += 1
                bad = sum(n for state, n in ran.items() if state != "done")
                progress.step(f"{bad} without result" if bad else "")
    return ran


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Limit numerical libraries in new processes to one thread each, during the block."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update({name: "1" for name in ONE_THREAD})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
