"""Predicates of one result of the benchmark: what was named beside what was hidden."""

from __future__ import annotations

from itertools import permutations
from typing import Any, Final

from models.shared.catalogue import CATALOGUE

Result = dict[str, Any]
"""Of `bench.gap.case_run`, with its case."""

CLEAR: Final = 15.0
"""d′ of a hidden effect from which nobody would overlook it."""
MORE_IS_LEFT: Final = ("reduced", "not in the catalogue", "no floor")
"""Verdicts that say that more may be missing than was named."""
LINK_PORTS: Final = ("bend_torque", "stiffness", "mass")


def is_link_effect(effect: str) -> bool:
    """Whether an effect is of the link, the payload or play, and not of servo or sensor."""
    port = CATALOGUE[effect].port
    return port in LINK_PORTS or effect in ("backlash", "aerodynamic_drag")


def hidden_separations(r: Result) -> dict[str, float]:
    """d′ of each hidden effect in the first screen, in standard deviations of it without one."""
    return {e: (v or 0.0) / r["null_standard_deviation"][e] for e, v in r["own"].items()}


def hidden_separation(r: Result) -> float:
    """d′ of the hidden effect as in `hidden_separations`, of a pair the larger; 0 without one."""
    return max(hidden_separations(r).values(), default=0.0)


def is_clear(r: Result) -> bool:
    """Whether the hidden effect has a d′ of 15 or more."""
    return hidden_separation(r) >= CLEAR


def _true(r: Result) -> str:
    return str(next(iter(r["case"]["hidden"])))


def is_among_first(r: Result, most: int) -> bool:
    """Whether the hidden effect is among so many names."""
    return _true(r) in r["named"][:most]


def is_first_name_right(r: Result) -> bool:
    """Whether the hidden effect is the first name."""
    return is_among_first(r, 1)


def first_turn(r: Result) -> tuple[list[str], list[str]]:
    """Names of the turn that included the first name, and the look-alikes declared with them.

    What was taken out again does not count.
    """
    turns = zip(r["chosen"], r["look_alikes"], strict=True)
    names, alike = next(turn for turn in turns if r["named"][0] in turn[0])
    return [e for e in names if e in r["named"]], [e for effects in alike for e in effects]


def is_in_class(r: Result) -> bool:
    """Whether the hidden effect is named first or is a declared look-alike of what is."""
    names, alike = first_turn(r)
    return _true(r) in [*names, *alike]


def is_class_right(r: Result) -> bool:
    """Whether anything is named, and in the class of the hidden effect."""
    return bool(r["named"]) and is_in_class(r)


def is_pair_named(r: Result) -> bool:
    """Whether both hidden effects are among the names."""
    return set(r["case"]["hidden"]) <= set(r["named"])


def is_larger_named(r: Result) -> bool:
    """Whether both effects of a pair are named, or the larger one by d′ with more said to be left.

    Where only the larger one is named and the verdict is "closed", nobody would look for the other.
    """
    separations = hidden_separations(r)
    larger = max(separations, key=lambda effect: separations[effect])
    return is_pair_named(r) or (larger in r["named"] and r["verdict"] in MORE_IS_LEFT)


def is_pair_in_class(r: Result) -> bool:
    """Whether both hidden effects are among two named ones or their declared look-alikes."""
    alike = [
        {*names, *(e for c in others for e in c)}
        for names, others in zip(r["chosen"], r["look_alikes"], strict=True)
        if set(names) <= set(r["named"])  # what was dropped again does not count
    ]
    if len(r["named"]) != 2:
        return False
    if len(alike) == 1:  # both in one turn
        return set(r["case"]["hidden"]) <= alike[0]
    return any(a in alike[0] and b in alike[1] for a, b in permutations(r["case"]["hidden"]))


def is_said_outside(r: Result) -> bool:
    """Whether the verdict says that an effect outside the catalogue is at work."""
    return bool(r["verdict"] == "not in the catalogue")


def strength_change(r: Result) -> tuple[float, float, float] | None:
    """Estimated change of the strength, its standard error and the hidden strength.

    Of an effect in one servo those of its joint; None where the first name is wrong.
    """
    if not is_first_name_right(r):
        return None
    of_joints = r["estimates"][_true(r)]  # the strengths of the joints come first
    value, error, before = of_joints[(r["case"].get("joint") or 1) - 1]
    return value - before, error or 0.0, r["true"][_true(r)]


def is_strength_covered(r: Result) -> bool | None:
    """Whether the strength lies within 1.96 standard errors; None where the name is wrong."""
    change = strength_change(r)
    return abs(change[0] - change[2]) <= 1.96 * change[1] if change else None
