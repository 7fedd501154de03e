"""Kind of cases: a plant's gap to a rig with hidden effects is diagnosed from the rig's trials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from firmware_py.core.motion import Kind, Motion
from hil.campaign.kinds.case_kind import CaseKind, CaseOptions, Seed, check_effects
from hil.campaign.kinds.rig_kind import changed_rig, rig_file


class GapOptions(CaseOptions, frozen=True, kw_only=True):
    """Options of a diagnosis."""

    plant: str  # Identified plant with its noise floor
    rig: str = "default"  # Structure, `drawn_K`, file that changes a structure, or link
    # Strength of each effect hidden in the rig
    effects: dict[str, float] = msgspec.field(default_factory=dict)
    # Factors on parameters of the rig
    factors: dict[str, float] = msgspec.field(default_factory=dict)
    payloads_kg: Annotated[
        tuple[Annotated[float, Meta(ge=0, le=10)], ...], Meta(min_length=1)
    ] = (0.0, 1.0, 2.0)  # fmt: skip
    trials: Annotated[int, Meta(ge=1, le=100)] = 2
    motion: Kind = "sinusoid"
    leave_out: tuple[str, ...] = ()  # Effects that are excluded from the search
    seed: Seed = 0  # Of variation and noise

    def __post_init__(self) -> None:
        check_effects({*self.effects, *self.leave_out})

    def files(self) -> dict[str, str]:
        return {"plant": self.plant} | rig_file(self.rig)


def run_diagnosis(options: GapOptions, scratch: Path) -> dict[str, Any]:
    from models.gap.diagnosis import diagnose  # loads CasADi
    from models.plant.plant import read_plant
    from models.rig.protocol import TrialCase, run_case  # slow to import
    from models.trials.trial import TrialSet

    rig = changed_rig(options.rig, options.factors, options.effects)
    trials = TrialSet(
        tuple(
            run_case(rig, TrialCase(Motion(options.motion), payload_kg, trial, options.seed))
            for payload_kg in options.payloads_kg
            for trial in range(1, options.trials + 1)
        )
    )
    diagnosis = diagnose(read_plant(options.plant), trials, leave_out=options.leave_out)
    values = diagnosis.fitted.parameters
    hidden = set(options.effects) - set(options.leave_out)
    return {
        "verdict": str(diagnosis.verdict),
        "named": list(diagnosis.named),
        "right": float(set(diagnosis.named) == hidden),
        "gap_left_fraction": diagnosis.gap_left_fraction,
        "largest_separation": diagnosis.naming.best.separation,
        "probabilities": msgspec.to_builtins(diagnosis.answers),
        "look_alikes": {
            name: ["+".join(fit.candidates) for fit in alike]
            for name, alike in diagnosis.look_alikes.items()
        },
        "strengths": {
            name: values[name].value
            for q in diagnosis.nuisance.estimator.residuals.fit_parameters
            if q.effect in diagnosis.named
            for name in q.parameters
            if name in values
        },
    }


KIND = CaseKind(
    name="gap",
    options=GapOptions,
    run=run_diagnosis,
    sources=("firmware_py", "models", "hil/campaign/kinds"),
    figures={
        "gap_left_fraction": "gap that is left",
        "largest_separation": "largest d′ of an effect",
        "right": "named rightly",
    },
)
