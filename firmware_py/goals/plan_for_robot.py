"""Goals of a plan for one robot: check that the two fit together, and choose the payload."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from firmware_py.config import RobotConfig
from firmware_py.core.errors import InputError
from firmware_py.goals.plan_goals import PlanGoals, check_plan_goals
from firmware_py.goals.plant_of_goals import note_on_plant
from firmware_py.goals.tip_feedback import TipFeedback
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.inference.bundle import ModelBundle

__all__ = ["feedback_of_plan", "goals_of_plan", "innovation_places", "log_facts"]


def goals_of_plan(plan: TipPlan, config: RobotConfig, bundle: ModelBundle) -> PlanGoals:
    """Return the goals of a plan, for the known payload of the configuration or the estimated one.

    A plan for another robot, bundle or link is refused, and one that violates the limits.
    """
    where = f"plan {plan.path}"
    if plan.dof != config.dof:
        raise InputError(
            where, f"is for {plan.dof} joints, the robot has {config.dof}", "plan for this robot"
        )
    if not math.isclose(plan.period_s, config.period_s):
        raise InputError(
            where, f"has a period of {plan.period_s:g} s, the robot {config.period_s:g} s",
            "plan for this robot",
        )  # fmt: skip
    if plan.bundle_sha256 != bundle.manifest_sha256:
        raise InputError(
            where, f"was made for another bundle than {bundle.directory}",
            f"plan again with --bundle {bundle.directory}",
        )  # fmt: skip
    note_on_plant(where, plan.plant_sha256, plan.link, bundle)  # refuses a plan of another link
    if config.payload_kg is None and bundle.manifest.estimator != "observer":
        raise InputError(
            where, f"needs the payload, which the estimator {bundle.manifest.estimator!r} of the "
            "bundle does not tell", "give payload_kg, or use a bundle with the observer",
        )  # fmt: skip
    check_plan_goals(plan, config.limits_in_force, where)
    return PlanGoals(plan, config.payload_kg, probes=config.feedback.use)


def feedback_of_plan(
    plan: TipPlan, goals: PlanGoals, config: RobotConfig, bundle: ModelBundle
) -> TipFeedback | None:
    """Return the feedback of a plan; None if it has none, or if robot.toml switches it off."""
    if plan.feedback is None or not config.feedback.use:
        return None
    places = innovation_places(bundle.told, plan.dof)
    if not places:
        raise InputError(
            f"plan {plan.path}", f"has feedback, but the estimator of {bundle.directory} does not "
            "tell when it is wrong: it has no innovation of the currents",
            "use a bundle with the observer, or run the plan with --open-loop",
        )  # fmt: skip
    return TipFeedback(plan, goals, config.feedback, places, bundle.assume_payload)


def innovation_places(told: Sequence[str], dof: int) -> list[int]:
    """Return the indices of the currents' innovations among the signals of an estimate."""
    names = [f"innovation_{j}_a" for j in range(1, dof + 1)]
    return [told.index(name) for name in names if name in told]


def log_facts(plan: TipPlan, config: RobotConfig) -> dict[str, str]:
    """Return the metadata of a plan's log, which replace those of the configured motion."""
    probed = {"probed": "true"} if plan.probe is not None and config.feedback.use else {}
    return probed | {
        "motion": msgspec.json.encode(plan.conditions()).decode(),
        "rest_samples": str(round(plan.rest_s / plan.period_s)),
    }
