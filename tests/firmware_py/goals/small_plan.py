"""Short plans made by hand."""

import numpy as np

from firmware_py.core.input_files import content_of
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan
from firmware_py.inference.manifest import MANIFEST
from firmware_py.link.link_facts import STUDY_FACTS

ROWS = 40
OTHER_PLANT = "was made with another plant than the bundle"


def column(largest_rad, rows=ROWS):
    return tuple((largest_rad * np.sin(np.pi * np.arange(rows) / (rows - 1)) ** 3).tolist())


def payload_plan(payload_kg, *goals_rad, **changes):
    """A payload of a plan whose tip and current are as large as its goals."""
    values = {
        "payload_kg": payload_kg, "goals_rad": goals_rad, "tip_m": goals_rad,
        "current_a": goals_rad, "residual_rms_m": 1e-3, "rigid_rms_m": 5e-2,
        "expected_rms_m": 2e-3,
    }  # fmt: skip
    return PayloadPlan(**values | changes)


def plan_of(*payloads, **changes):
    """A plan that desires the tip of its first payload."""
    desired_m = payloads[0].tip_m
    values = {
        "schema": 1, "path": "circle", "method": "inverse", "dof": len(desired_m),
        "period_s": PERIOD_S, "rest_s": PERIOD_S, "start_row": 0, "end_row": len(desired_m[0]),
        "drawn": (), "desired_m": desired_m, "payloads": payloads, "payload_rate_kg_s": 0.5,
        "plant_error_rms_m": None, "plant_sha256": "", "bundle_sha256": "", "link": STUDY_FACTS,
    }  # fmt: skip
    return TipPlan(**values | changes)


def small_plan(bundle):
    """Plan of one joint for a bundle: 0.024 rad with 0 kg, 0.020 rad with 1 kg."""
    payloads = (
        payload_plan(payload_kg, column(largest), current_a=(column(0.1),))
        for payload_kg, largest in ((0.0, 0.024), (1.0, 0.020))
    )
    return plan_of(
        *payloads, start_row=5, end_row=30, drawn=((5, 30),), desired_m=(column(0.02),),
        bundle_sha256=content_of(bundle / MANIFEST).sha256,
    )  # fmt: skip
