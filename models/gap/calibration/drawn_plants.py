"""Plants of drawn rigs, each identified on trials of its own rig without a hidden effect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from models.plant.identification.identify import identify
from models.plant.identification.noise_floor import with_noise_floor
from models.plant.plant import Plant, read_plant
from models.rig.parameters import RigParameters
from models.rig.protocol import TrialCase, run_case
from models.trials.trial import TrialSet


def plant_on_rig(
    rig: RigParameters, cases: Sequence[TrialCase], path: Path, start: Plant | None = None
) -> Path:
    """Plant file with a noise floor; identified on trials of a rig if the file does not exist yet.

    `cases`: trials to run; the plant has a noise floor if some are repeated. `start`: plant that
    the identification starts from; the packaged one by default.
    """
    if not path.exists():
        trials = TrialSet(tuple(run_case(rig, case) for case in cases))
        found = identify(read_plant() if start is None else start, trials).plant
        path.parent.mkdir(parents=True, exist_ok=True)
        with_noise_floor(found, trials.trials).write(path)
    return path
