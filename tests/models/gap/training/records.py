"""Records of data sets as diagnoses would leave them, without a diagnosis."""

import zlib

import numpy as np

from models.gap.decision.certainty import Evidence
from models.gap.training.case_runs import DataSetRecord, Strength

EQUATION_ERROR = 0.2


def made_record(case):
    """A clear effect is named rightly, a denied one leaves much unexplained."""
    rng = np.random.default_rng(zlib.crc32(repr(case).encode()))
    separation, difference, left = {
        "null": (3.0, 0.3, 1.0), "outside": (30.0, 0.6, 0.9),
    }.get(case.kind, (40.0, 0.05, 0.1))  # fmt: skip
    if case.motion != "study":
        separation *= 8
    separation *= float(np.exp(0.3 * rng.standard_normal()))
    difference += 0.05 * rng.random()
    best = "creep" if case.kind in ("null", "outside") else next(iter(case.hidden))
    strengths = [
        Strength(e, 1.0 + EQUATION_ERROR * rng.standard_normal(), 0.01, 1.0)
        for e in case.hidden if case.kind != "outside"
    ]  # fmt: skip
    return DataSetRecord(
        case=case, best=(best,), separation=separation, alone={best: separation},
        evidence=Evidence(separation, difference, left, False),
        residual_before=1 + 0.1 * rng.random(), residual_after=1.0,
        named=() if case.kind == "null" else (best,), strengths=tuple(strengths),
    )  # fmt: skip
