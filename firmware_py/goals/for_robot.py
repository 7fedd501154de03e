"""Goals of one run: of the motion, a plan or another program, checked against robot and bundle."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from firmware_py.config import RobotConfig
from firmware_py.core.errors import InputError
from firmware_py.goals.goal_channel import accepted_program
from firmware_py.goals.goal_map import GoalMap, read_goal_map
from firmware_py.goals.goal_source import GoalSource, GoalTable
from firmware_py.goals.outside_goals import OutsideGoals
from firmware_py.goals.plan_goals import PlanGoals, check_plan_goals
from firmware_py.goals.tip_feedback import Correction, TipFeedback
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import LinkFacts, facts_of_plant, other_link
from firmware_py.log.recording import OUTSIDE


class RunGoals(NamedTuple):
    """Goals of a run, and what its log says of them."""

    source: GoalSource
    name: str  # Name of the motion
    facts: dict[str, str]  # Metadata of the log, which replace those of the configured motion
    note: str = ""  # Warning that they were made with another plant than the bundle's, or ""
    correction: Correction | None = None  # Feedback of the tip, which is added to the goals

    @property
    def metadata(self) -> dict[str, str]:
        return self.facts | ({"goals_note": self.note} if self.note else {})


def note_on_plant(where: str, plant_sha256: str, link: LinkFacts, bundle: ModelBundle) -> str:
    """Return a sentence if goals were made with another plant of the same link, or "".

    Goals of another link are refused. A bundle without a plant does not describe its link, so only
    the sentence is returned.
    """
    theirs = bundle.manifest.plant_sha256
    if not theirs or plant_sha256 == theirs:
        return ""
    facts = facts_of_plant(bundle.plant)
    if facts is not None and (fact := other_link(link, facts)):
        raise InputError(
            where, f"was made for another link than that of {bundle.directory}: {fact}",
            "make it again with the plant of this link",
        )  # fmt: skip
    return (
        f"{where} was made with another plant than the bundle {bundle.directory} (plant_sha256): "
        "its goals and the robot's prediction may differ; train the bundle again with this plant "
        "for the best accuracy"
    )


def goals_of_motion(config: RobotConfig, *, repeated: bool) -> RunGoals:
    """Return the goals of the configured motion, which run once or are repeated."""
    table = GoalTable(config.goals_rad(repeated=repeated))
    return RunGoals(table, config.motion.kind, {})


def goals_of_plan(
    plan: TipPlan, config: RobotConfig, bundle: ModelBundle, where: str = ""
) -> RunGoals:
    """Return the goals of a plan, for the known payload of the configuration or the estimated one.

    A plan for another robot, bundle or link is refused, and one that violates the limits.
    """
    where = where or f"plan {plan.path}"
    _check_fit(where, plan, config, "plan for this robot")
    if plan.bundle_sha256 != bundle.manifest_sha256:
        raise InputError(
            where, f"was made for another bundle than {bundle.directory}",
            f"plan again with --bundle {bundle.directory}",
        )  # fmt: skip
    note = note_on_plant(where, plan.plant_sha256, plan.link, bundle)
    if config.payload_kg is None and bundle.manifest.estimator != "observer":
        raise InputError(
            where, f"needs the payload, which the estimator {bundle.manifest.estimator!r} of the "
            "bundle does not tell", "give payload_kg, or use a bundle with the observer",
        )  # fmt: skip
    check_plan_goals(plan, config.limits_in_force, where)
    goals = PlanGoals(plan, config.payload_kg, probes=config.feedback.use)
    facts = {
        "motion": msgspec.json.encode(plan.conditions()).decode(),
        "rest_samples": str(round(plan.rest_s / plan.period_s)),
    }
    if plan.probe is not None and config.feedback.use:
        facts["probed"] = "true"
    return RunGoals(goals, plan.name, facts, note, _feedback(where, plan, goals, config, bundle))


def _feedback(
    where: str, plan: TipPlan, goals: PlanGoals, config: RobotConfig, bundle: ModelBundle
) -> TipFeedback | None:
    """Return the feedback of a plan; None if it has none, or if robot.toml switches it off."""
    if plan.feedback is None or not config.feedback.use:
        return None
    places = innovation_places(bundle.signal_names, plan.dof)
    if not places:
        raise InputError(
            where, f"has feedback, but the estimator of {bundle.directory} does not "
            "tell when it is wrong: it has no innovation of the currents",
            "use a bundle with the observer, or run the plan with --open-loop",
        )  # fmt: skip
    return TipFeedback(plan, goals, config.feedback, places, bundle.assume_payload)


def goals_of_program(goals: OutsideGoals) -> RunGoals:
    """Return the goals of another program.

    Duration and amplitude are unknown when the log begins; readers derive them from the goals.
    """
    motion = msgspec.json.encode({"motion": OUTSIDE}).decode()
    return RunGoals(goals, OUTSIDE, {"motion": motion, "rest_samples": "1"}, goals.note)


def innovation_places(signals: Sequence[str], dof: int) -> list[int]:
    """Return the indices of the currents' innovations among the signals of an estimate."""
    names = [f"innovation_{j}_a" for j in range(1, dof + 1)]
    return [signals.index(name) for name in names if name in signals]


WAIT_S: Final = 60.0
"""Longest wait for the program, before the torque is switched on [assumed]."""


@contextlib.contextmanager
def outside_goals(
    address: str,
    map_path: Path | None,
    config: RobotConfig,
    bundle: ModelBundle,
    patience_s: float = 0.0,
) -> Iterator[OutsideGoals]:
    """Wait for the program that sends goals, and yield its goals; at the end the connection closes.

    `bundle`: the robot's bundle, whose plant is compared with that of the map.
    `patience_s`: see `SocketChannel`.
    """
    if config.bus.replug_s > 0:  # during the wait the goals would move away from the arm
        raise InputError(
            "bus.replug_s", f"is {config.bus.replug_s:g}, but another program sends the goals, and "
            "it does not know what the arm did while the port was gone",
            "set it to 0 for runs with --goals; the robot then stays stopped",
        )  # fmt: skip
    goal_map, note = None, ""
    if map_path is not None:
        goal_map = read_goal_map(map_path)
        _check_fit(map_path, goal_map, config, "make it anew")
        note = note_on_plant(str(map_path), goal_map.plant_sha256, goal_map.link, bundle)
    with accepted_program(address, WAIT_S, patience_s) as channel:
        yield OutsideGoals(
            channel, config.limits_in_force, config.dof, config.period_s, goal_map,
            config.payload_kg, note,
        )  # fmt: skip


def _check_fit(
    where: Path | str, goals: TipPlan | GoalMap, config: RobotConfig, remedy: str
) -> None:
    """Refuse goals for another number of joints or another period than the robot's."""
    if goals.dof != config.dof:
        raise InputError(
            where, f"is for {goals.dof} joints, the robot has {config.dof}", remedy
        )  # fmt: skip
    if not math.isclose(goals.period_s, config.period_s):
        raise InputError(
            where, f"has a period of {goals.period_s:g} s, the robot {config.period_s:g} s", remedy
        )
