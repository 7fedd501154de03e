"""Kind of cases: a plant's gap to a rig with hidden effects is diagnosed from the rig's trials."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS as MOTIONS
from hil.campaign.kinds.case_kind import CaseConfig, CaseContext, CaseKind
from hil.campaign.kinds.config_checks import check_effects_known, check_ranges
from hil.campaign.kinds.rig_kind import changed_rig


class GapConfig(CaseConfig, frozen=True, kw_only=True):
    """Configuration of a diagnosis."""

    plant: str  # Identified plant with its noise floor
    rig: str = "default"  # Structure, `drawn_K`, file that changes a structure, or link
    # Strength of each effect hidden in the rig
    effects: dict[str, float] = msgspec.field(default_factory=dict)
    # Factors on parameters of the rig
    factors: dict[str, float] = msgspec.field(default_factory=dict)
    payloads_kg: tuple[float, ...] = (0.0, 1.0, 2.0)
    trials: int = 2
    motion: str = "sinusoid"
    leave_out: tuple[str, ...] = ()  # Effects that are excluded from the search
    seed: int = 0  # Seed of variation and noise


class GapKind(CaseKind[GapConfig]):
    """Diagnoses."""

    name: ClassVar[str] = "gap"
    config: ClassVar[type[GapConfig]] = GapConfig
    rooms: ClassVar[tuple[str, ...]] = ("firmware_py", "models", "hil/campaign/kinds")
    figures: ClassVar = {
        "gap_left_fraction": "gap that is left",
        "largest_separation": "largest d′ of an effect",
        "right": "named rightly",
    }

    def files(self, config: GapConfig) -> dict[str, str]:
        return {"plant": config.plant} | ({"rig": config.rig} if Path(config.rig).is_file() else {})

    def check(self, config: GapConfig) -> None:
        check_effects_known(config.effects)
        check_effects_known(dict.fromkeys(config.leave_out, 0.0))
        check_ranges(config, payloads_kg=(0.0, 10.0), trials=(1, 100), seed=(0, 2**32 - 1))
        if config.motion not in MOTIONS:
            raise InputError("motion", f"{config.motion!r} is no kind", ", ".join(MOTIONS))
        if not config.payloads_kg:
            raise InputError("payloads_kg", "is empty", "give one payload or more")

    def run(self, config: GapConfig, context: CaseContext) -> dict[str, Any]:
        import time

        from firmware_py.core.motion import Motion
        from models.gap.diagnosis import diagnose  # loads CasADi
        from models.plant.plant import read_plant
        from models.rig.protocol import TrialCase, run_case  # slow to import
        from models.trials.trial import TrialSet

        plant = read_plant(config.plant)
        rig = changed_rig(config.rig, config.factors).hide(config.effects)
        kind = next(k for k in MOTIONS if k == config.motion)
        trials = TrialSet(
            tuple(
                run_case(rig, TrialCase(Motion(kind), payload_kg, trial, config.seed))
                for payload_kg in config.payloads_kg
                for trial in range(1, config.trials + 1)
            )
        )
        start_s = time.perf_counter()
        found = diagnose(plant, trials, leave_out=config.leave_out)
        context.parts_s["diagnosis"] = time.perf_counter() - start_s
        values = found.fitted.parameters
        wanted = set(config.effects) - set(config.leave_out)
        return {
            "verdict": str(found.verdict),
            "named": list(found.named),
            "right": float(set(found.named) == wanted),
            "gap_left_fraction": found.gap_left_fraction,
            "largest_separation": found.naming.best.separation,
            "probabilities": msgspec.to_builtins(found.answers),
            "look_alikes": {
                name: ["+".join(fit.candidates) for fit in alike]
                for name, alike in found.look_alikes.items()
            },
            "strengths": {
                name: values[name].value
                for q in found.nuisance.estimator.residuals.fit_parameters
                if q.effect in found.named
                for name in q.parameters
                if name in values
            },
        }


KIND = GapKind()
