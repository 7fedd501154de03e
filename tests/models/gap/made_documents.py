"""Documents of a diagnosis that no diagnosis has made."""

from models.gap.decision.certainty import Answers
from models.gap.report import gap_json as gap
from models.gap.residuals.localisation import GapRegion
from models.gap.settings import DEFAULT_SETTINGS

TIP, ANGLE = "tip_x_m", "angle_1_rad"


def effect(name, joint=None, look_alikes=(), parameters=None, **others):
    values = parameters or {f"{name}_1_x": gap.FittedValue(0.03, "s", 0.001, 0.0)}
    return gap.NamedEffect(
        effect=name, joint=joint, parameters=values,
        evidence=gap.NamingEvidence(40.0, 25.0, 0.05, 1.1),
        look_alikes=tuple(gap.SimilarEffects((e,), 38.0) for e in look_alikes), **others,
    )  # fmt: skip


def errors(tip_m, angle_rad):
    """Errors by signal; the floor is 1 mm and 1 mrad."""
    signals = {
        TIP: gap.SignalGap(tip_m, "m", tip_m / 1e-3),
        ANGLE: gap.SignalGap(angle_rad, "rad", angle_rad / 1e-3),
    }
    return gap.PlantErrors({}, signals)


def document(verdict="no gap", *rows, answers=(0.0, 0.98, 0.02), learned=True, **changes):
    names = tuple(row.candidate for row in rows)
    parameters = {"dead_time_1_s": gap.FittedValue(0.03, "s", 0.001, 0.0)} if rows else {}
    plain = {
        "probabilities": Answers(*answers) if answers else None,
        "gap_left_fraction": 0.2,
        "separation_of_nothing": 25.0,
        "effect_probabilities": dict.fromkeys(names, 0.97),
        "rejected": (),
        "written": gap.WrittenPlant(names, parameters),
        "sentence": "With link and set-up refitted, the tip (x) differs most.",
        "located": (),
        "map": tuple(
            GapRegion(signal, "trial", name, size, 0.0, 0.0, True)
            for signal, size in ((ANGLE, 9.0), (TIP, 3.0))
            for name in ("one", "two")
        ),
        "noise_floor": gap.NoiseFloorSummary(
            learned, {s: gap.SignalFloor(1e-3, 0.0, 1e-3) for s in (TIP, ANGLE)}
        ),
        "before": errors(4.41e-3, 12.1e-3),
        "after": errors(4.44e-3, 3.3e-3),
        "held_out": gap.HeldOutSummary(("payloads",), 0.4),
        "settings": DEFAULT_SETTINGS,
    }
    return gap.GapDocument(
        schema=gap.GapDocument.VERSION, verdict=verdict, named=rows, **plain | changes
    )
