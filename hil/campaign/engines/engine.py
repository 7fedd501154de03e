"""Interface of the engines, and the rule for cases whose worker dies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, Protocol

from hil.campaign.case_task import CaseTask, TaskOutcome

ATTEMPTS: Final = 3
"""Attempts at a case whose worker dies. The cause may lie elsewhere, such as memory that another
program used up, but a case that kills every worker has to end [assumed]."""


class Engine(Protocol):
    """Engine that runs cases in workers."""

    # Whether other programs may use the workers' processors, so that timing cannot be measured
    shared: bool

    def outcomes(self, tasks: Sequence[CaseTask]) -> Iterator[TaskOutcome]:
        """Run tasks; yield one outcome for each, as they end.

        The workers end with the iterator, even if it is closed early. `tasks` may create each task
        only on access.
        """
        ...


def killed_outcome(key: str, how: str, log: str = "") -> TaskOutcome:
    """Return the outcome of a case whose workers died in every attempt."""
    return TaskOutcome(
        key=key, state="killed", log=f"{how}\n{log}".strip(),
        sentence="its worker died each time that it was begun",
    )  # fmt: skip
