"""Forty wrong imports with the cause that must be named, and forty right ones."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bench.imports.take_files import ORIGIN_M, WrittenTake
from models.trials.trial import Trial


class ImportCase(NamedTuple):
    """One import."""

    name: str
    take: WrittenTake
    trial: Trial
    cause: str  # Words that a refusal or a warning must hold; "" for a right import


def wrong_cases(one: Trial, two: Trial, seed: int) -> list[ImportCase]:
    """The wrong imports.

    `one`, `two`: with one joint and with two that move out of phase.
    """
    rng = np.random.default_rng(seed)
    cases: list[ImportCase] = []

    def add(name: str, cause: str, trial: Trial = one, **fields: Any) -> None:
        offset_s = float(rng.uniform(-2, 2))
        cases.append(ImportCase(name, WrittenTake(offset_s=offset_s, **fields), trial, cause))

    add("sign of joint 1", "joint 1 counts the other way", signs=(-1.0, 1.0))
    add("sign of joint 1 of 2", "joint 1 counts the other way", two, signs=(-1.0, 1.0))
    add("sign of joint 2", "joint 2 counts the other way", two, signs=(1.0, -1.0))
    add("signs of both", "joint 1 and joint 2 count the other way", two, signs=(-1.0, -1.0))
    add("joints swapped", "joints 1 and 2 are swapped", two, swap_joints=True)
    for pair in (("m05", "m06"), ("m01", "m03"), ("m02", "m14"), ("m09", "m13"), ("m13", "m16")):
        add(f"{pair[0]}, {pair[1]}", f"{pair[0]} and {pair[1]} are swapped", **_named(pair))
    add("two pairs", "are swapped", **_named(("m05", "m06"), ("m10", "m15")))
    for a, b in ((1, 2), (0, 3)):
        rows = [(f"m{4 * a + k:02d}", f"m{4 * b + k:02d}") for k in range(1, 5)]
        add(f"rows {a + 1}, {b + 1}", "rows are named in the order", **_named(*rows))
    mirrored = [(f"m{k:02d}", f"m{k + 1:02d}") for k in range(1, 17, 2)]
    add("mirrored corners", "corners are named in the order", **_named(*mirrored))
    for up_m in (-0.42, -0.1, 0.05, 0.015):
        way = "low" if up_m < 0 else "high"
        add(f"origin z {up_m:+}", f"m too {way}", wrong=_origin((0.0, 0.0, up_m)))
    for aside_m in ((0.1, 0.0, 0.0), (0.02, -0.03, 0.0)):
        add(f"origin {aside_m}", "m aside", wrong=_origin(aside_m))
    add("y-up read as z-up", "is y-up", wrong={"up": "z"})
    add("z-up read as y-up", "is z-up", files_up="z", wrong={"up": "y"})
    add("y-up read as x-up", "is y-up", wrong={"up": "x"})
    for yaw in (3.0, -8.0, 12.0, 29.0, 90.0):
        add(f"yaw {yaw:g}", "yaw_deg", wrong={"yaw_deg": yaw})
    add("absent m05", "m05 is mapped to", absent=("m05",))
    add("absent m16", "m16 is mapped to", absent=("m16",))
    add("absent row", "is mapped to", absent=("m09", "m10", "m11", "m12"))
    for rest in (1, 8):
        at_s = one.time_s[one.meta.rest_samples - 1] - (rest - 1) * one.step_s
        add(f"{rest} rows at rest", "rest before the motion", first_s=float(at_s))
    for length_s in (0.2, 0.5, 1.0, 2.0):
        add(f"servo gap {length_s:g} s", "has no samples for", gap_s=(4.0, length_s))
    add("decimal commas", "decimal commas", commas=True)
    add("decimal commas, 2 joints", "decimal commas", two, commas=True)
    add("scale 1.1", "times those of the link", align="rest", scale=1.1)
    return cases


def right_cases(trials: list[Trial], count: int, seed: int) -> list[ImportCase]:
    """Right imports of many kinds."""
    rng = np.random.default_rng([seed, 1])
    cases = []
    for k in range(count):
        trial = trials[k % len(trials)]
        take = WrittenTake(
            offset_s=float(rng.uniform(-2, 2)),
            epoch_s=float(rng.choice([0.0, 0.0, 1.7e9])),
            yaw_deg=float(rng.choice([0.0, 90.0, -37.0])),
            files_up=str(rng.choice(["y", "z"])),
            millimetres=bool(rng.random() < 0.5),
            align=str(rng.choice(["none", "none", "rest"])),
            first_s=float(rng.choice([0.0, 0.3])),
            lost=float(rng.choice([0.0, 0.01])),
            occluded=float(rng.choice([0.0, 0.02])),
        )
        cases.append(ImportCase(f"right {k + 1}, {trial.name}", take, trial, ""))
    return cases


def _named(*pairs: tuple[str, str]) -> dict[str, Any]:
    names = dict(pairs) | {b: a for a, b in pairs}
    return {"names": names}


def _origin(shift_m: tuple[float, float, float]) -> dict[str, Any]:
    return {"origin_m": (ORIGIN_M + np.array(shift_m)).tolist()}
