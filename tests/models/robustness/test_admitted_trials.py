"""Every trial that the contract admits is used, or refused in one sentence.

`make test` runs a few of the cases; `ADMITTED=all pytest tests/models/robustness` runs all of them
(a quarter of an hour).
"""

import functools
import json
import math
import os
import re

import pytest

from dropstitch.__main__ import main
from models.gap.estimation import fitted_floor, gauss_newton, nuisance_fit
from models.gap.residuals import localisation
from models.gap.residuals.fit_parameters import candidate_effects
from models.gap.search import effect_search, far_strengths
from models.plant.identification import identify as identification
from models.plant.identification import noise_floor
from models.trials.files import write_trial
from tests.models.robustness.mutations import CASES, PLANT_CASES
from tests.models.robustness.short_trials import plant_of, short_trials

pytestmark = pytest.mark.slow

CONSIDERED = {
    "link": ("coulomb_friction", "unmodelled_payload", "current_saturation"),
    "pendulum": ("coulomb_friction", "current_saturation"),
    "guide": ("coulomb_friction", "load_offset"),
}
FEW_STEPS = {
    fitted_floor: {"FLOOR_ROUNDS": 1},
    nuisance_fit: {"ROUNDS": 1},
    gauss_newton: {"NUISANCE_FIT_STEPS": 2, "FIT_STEPS": 2},
    effect_search: {"REFITTED": 1, "REFITTED_PAIRS": 1, "START_STEPS": 1, "FIT_STEPS": 1},
    far_strengths: {"LADDER_BOUND_FRACTIONS": (0.5,), "LADDER_REFINEMENTS": 1, "FIT_STEPS": 1},
    localisation: {"BOOTSTRAP_DRAWS": 20},
}
ONE_SENTENCE = re.compile(r"dropstitch: .+; .+\.")
QUICK = {
    ("link", "50 rows"), ("link", "markers mostly occluded"),
    ("link", "no motion capture in one trial"),
    ("pendulum", "3 rows"), ("pendulum", "lengths, steps and motions differ"),
    ("pendulum", "condition that is not a number"), ("pendulum", "gain of a million"),
    ("pendulum", "current, but no angle"), ("pendulum", "nothing measured"),
    ("guide", "nothing moves"), ("guide", "period of zero"), ("guide", "one trial"),
    ("guide", "ten microseconds between rows"),
}  # fmt: skip
WANTED = [
    pytest.param(*case, id=f"{case[0]}: {case[1]}")
    for case in [*((*c, lambda plant: plant) for c in CASES), *PLANT_CASES]
    if os.environ.get("ADMITTED") == "all" or case[:2] in QUICK
]


@pytest.fixture(scope="session")
def made():
    """Function kind -> trials as the plant makes them."""
    return functools.lru_cache(short_trials)


@pytest.fixture
def few_steps(monkeypatch):
    """Fits end after a few steps: the figures do not matter here."""
    fit = identification.fit_objective
    monkeypatch.setattr(
        identification, "fit_objective",
        lambda objective, start=None, **o: fit(objective, start, **o | {"evaluations": 2}),
    )  # fmt: skip
    monkeypatch.setattr(identification, "DRAWS", 3)
    monkeypatch.setattr(identification, "STIFFNESS_SCAN", (1.0,))
    for module, constants in FEW_STEPS.items():
        for name, value in constants.items():
            monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(noise_floor, "FLOOR_ROUNDS", 1)
    monkeypatch.setattr(noise_floor, "FIT_STEPS", 2)


def check(capsys, argv, documents):
    """Run a command; it either ends with documents of finite numbers or with one sentence."""
    code = main([str(a) for a in argv])
    said = [row for row in capsys.readouterr().err.splitlines() if row.startswith("dropstitch: ")]
    assert code in (0, 1, 2)
    if code == 2:
        assert len(said) == 1 and ONE_SENTENCE.fullmatch(said[0]), said
        return
    assert not said
    for path in documents:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"\b(NaN|Infinity)\b", text), path.name
        assert all(math.isfinite(v) for v in numbers(json.loads(text)))


def numbers(value):
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from numbers(part)
    elif isinstance(value, float):
        yield value


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(("kind", "name", "change", "of_plant"), WANTED)
def test_an_admitted_trial_is_used_or_refused_in_one_sentence(
    kind, name, change, of_plant, made, few_steps, tmp_path, capsys
):
    trials, plant, out = tmp_path / "trials", of_plant(plant_of(kind)), tmp_path / "gap"
    for trial in change(list(made(kind))):
        write_trial(trial, trials)
    given, identified = tmp_path / "given.json", tmp_path / "plant.json"
    plant.write(given)
    check(capsys, ["evaluate", trials, "--plant", given], [])
    check(capsys, ["identify", trials, "--plant", given, "--out", identified], [identified])
    used = identified if identified.exists() and kind == "link" else given
    denied = [e for e in candidate_effects(plant) if e not in CONSIDERED[kind]]
    argv = ["gap", trials, "--plant", used, "--out", out]
    argv += [a for e in denied for a in ("--without", e)]
    check(capsys, argv, [out / "gap.json", out / "plant.json"])
