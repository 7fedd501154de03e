"""A short plan of one joint, made by hand: 0.024 rad with 0 kg, 0.020 rad with 1 kg."""

import numpy as np

from firmware_py.core.input_files import content_of
from firmware_py.core.signals import PERIOD_S
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan
from firmware_py.inference.manifest import MANIFEST
from firmware_py.link.link_facts import STUDY_FACTS

ROWS = 40
OTHER_PLANT = "was made with another plant than the bundle"


def column(largest_rad):
    return tuple((largest_rad * np.sin(np.pi * np.arange(ROWS) / (ROWS - 1)) ** 3).tolist())


def small_plan(bundle):
    """Plan for the bundle of a directory."""
    payloads = tuple(
        PayloadPlan(
            payload_kg=payload_kg, goals_rad=(column(largest),), tip_m=(column(largest),),
            current_a=(column(0.1),), residual_rms_m=1e-3, rigid_rms_m=5e-2, expected_rms_m=2e-3,
        )
        for payload_kg, largest in ((0.0, 0.024), (1.0, 0.020))
    )  # fmt: skip
    return TipPlan(
        schema=1, path="circle", method="inverse", dof=1, period_s=PERIOD_S, rest_s=PERIOD_S,
        start_row=5, end_row=30, drawn=((5, 30),), desired_m=(column(0.02),), payloads=payloads,
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", link=STUDY_FACTS,
        bundle_sha256=content_of(bundle / MANIFEST).sha256,
    )  # fmt: skip
