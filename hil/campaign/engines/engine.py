"""Interface of the engines, and the rule for cases whose worker dies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, Protocol

from hil.campaign.case_task import CaseTask, TaskOutcome

ATTEMPTS: Final = 3
"""Times that a case is begun before it is given up: a worker may die by another's fault, such as
memory that runs out, a case that kills each worker has to end [assumed]."""


class Engine(Protocol):
    """Engine that brings cases to workers."""

    # Whether other programs may use the workers' processors, so that time cannot be measured
    shared: bool

    def outcomes(self, tasks: Sequence[CaseTask]) -> Iterator[TaskOutcome]:
        """Run tasks; yield one outcome for each, in the order of their ends.

        Workers end with the iterator, also where it is closed early.

        `tasks`: to run; may make each task when it is asked for.
        """
        ...


def killed_outcome(key: str, how: str, log: str = "") -> TaskOutcome:
    """Outcome of a case that was given up because its workers died."""
    return TaskOutcome(
        key=key, state="killed", log=f"{how}\n{log}".strip(),
        sentence="its worker died each time that it was begun",
    )  # fmt: skip
