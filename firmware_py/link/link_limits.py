"""Limits of a robot whose configuration names its link, and a check of its servos."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.link.link_description import LinkDescription, read_link
from firmware_py.safety.limits import Limits

BOX_MARGIN: Final = 1.2
"""Ratio of the tip's box to the reach of a straight link [assumed]: room for the bend."""


def limits_with_link(
    where: Path, link_file: str, models: Sequence[str], limits: Limits, given: Collection[str]
) -> Limits:
    """Return the limits of a configuration that names a link; `given` has its keys of [limits]."""
    link = read_link(where.parent / link_file)
    refuse_other_servos(link, models, where)
    return limits_of_link(link, limits, given)


def refuse_other_servos(link: LinkDescription, models: Sequence[str], where: Path | str) -> None:
    """Refuse servos of another model than the link's."""
    if len(models) > link.joints:
        raise InputError(
            where, f"servos has {len(models)} entries, the link {link.joints} joint",
            "correct 'servos', or 'joints' in the link's file",
        )  # fmt: skip
    for model in models:
        if model != link.servo.model:
            raise InputError(
                where, f"servo {model} is not the link's {link.servo.model}",
                "correct 'servos', or [servo] in the link's file",
            )  # fmt: skip


def limits_of_link(link: LinkDescription, limits: Limits, given: Collection[str]) -> Limits:
    """Return limits in which the link sets the tip's box, current and rate that are not given.

    Current and rate are only lowered, to the limits of the servo.
    """
    reach_m = round(BOX_MARGIN * (link.base_offset_m + link.length_m), 3)
    own = {
        "tip_min_m": (-reach_m, -reach_m, -reach_m),
        "tip_max_m": (reach_m, reach_m, reach_m),
        "current_a": min(limits.current_a, link.preset.current_limit_a),
        "rate_rad_s": min(limits.rate_rad_s, link.preset.speed_limit_rad_s),
    }
    return msgspec.structs.replace(
        limits, **{key: value for key, value in own.items() if key not in given}
    )
