"""Gap documents without a diagnosis."""

import pytest

from models.gap.decision.certainty import Answers
from models.gap.report.gap_json import (
    FittedValue,
    GapDocument,
    HeldOutSummary,
    MappedRegion,
    NamedEffect,
    NamingEvidence,
    NoiseFloorSummary,
    RemainingGap,
    SignalFloor,
    SignalGap,
    SimilarEffects,
    WrittenPlant,
)
from models.gap.settings import DEFAULT_SETTINGS

TIP, ANGLE = "tip_x_m", "angle_1_rad"


def named(effect, joint=None, look_alikes=(), parameters=None, **others):
    values = parameters or {f"{effect}_1_x": FittedValue(0.03, "s", 0.001, 0.0)}
    return NamedEffect(
        effect=effect, joint=joint, parameters=values,
        evidence=NamingEvidence(40.0, 25.0, 0.05, 0.2),
        look_alikes=tuple(SimilarEffects((e,), 38.0) for e in look_alikes), **others,
    )  # fmt: skip


def errors(tip_m, angle_rad):
    """Errors by signal; the floor is 1 mm and 1 mrad."""
    return {
        "held_out": {
            TIP: SignalGap(tip_m, "m", tip_m / 1e-3),
            ANGLE: SignalGap(angle_rad, "rad", angle_rad / 1e-3),
        }
    }


@pytest.fixture
def document():
    """Function (verdict, *named, probabilities, …) -> gap document."""

    def make(verdict="no gap", *rows, answers=(0.0, 0.98, 0.02), learned=True, **changes):
        written = tuple(row.candidate for row in rows)
        parameters = {"dead_time_1_s": FittedValue(0.03, "s", 0.001, 0.0)} if rows else {}
        plain = {
            "probabilities": Answers(*answers) if answers else None,
            "gap_left_fraction": 0.2,
            "separation_of_nothing": 25.0,
            "effect_probabilities": dict.fromkeys(written, 0.97),
            "rejected": (),
            "written": WrittenPlant(written, parameters),
            "sentence": "With link and set-up refitted, the tip (x) differs most.",
            "located": (),
            "map": tuple(
                MappedRegion(signal, "trial", name, size, 0.0, 0.0, True)
                for signal, size in ((ANGLE, 9.0), (TIP, 3.0))
                for name in ("one", "two")
            ),
            "remaining": RemainingGap("", ()),
            "noise_floor": NoiseFloorSummary(
                learned, {s: SignalFloor(1e-3, 0.0, 1e-3) for s in (TIP, ANGLE)}
            ),
            "before": errors(4.41e-3, 12.1e-3),
            "after": errors(4.44e-3, 3.3e-3),
            "held_out": HeldOutSummary(("payloads",), 0.4),
            "settings": DEFAULT_SETTINGS,
        }
        return GapDocument(
            schema=GapDocument.VERSION, verdict=verdict, named=rows, **plain | changes
        )

    return make


@pytest.fixture
def effect():
    """Function (effect, joint, look-alikes, parameters) -> named effect."""
    return named
