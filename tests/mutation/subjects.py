"""What is mutated, and which tests have to notice.

Code and tests are named by path, so that moving them changes this table alone. Tests that are
marked slow are left out except where they are few, so that a mutant costs seconds.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]


class Subject(NamedTuple):
    """Code that decides one kind of thing."""

    name: str
    modules: tuple[str, ...]
    """Patterns of paths below the root; one that begins with "!" takes away."""
    tests: tuple[str, ...]
    slow: bool = False
    """Whether tests run that are marked slow."""

    def paths(self, root: Path = ROOT) -> list[Path]:
        taken = {p for m in self.modules if m[0] != "!" for p in root.glob(m)}
        return sorted(taken - {p for m in self.modules if m[0] == "!" for p in root.glob(m[1:])})

    def pytest_arguments(self) -> tuple[str, ...]:
        return self.tests if self.slow else ("-m", "not slow", *self.tests)


SUBJECTS = (
    Subject("bus", ("firmware_py/bus/*.py",), ("tests/firmware_py/bus",)),
    Subject(
        "supervisor",
        ("firmware_py/safety/*.py", "firmware_py/system/stop_signals.py",
         "!firmware_py/safety/estimate_trust.py"),
        ("tests/firmware_py/safety", "tests/firmware_py/system/test_stop_signals.py",
         "tests/firmware_py/test_loop.py", "tests/firmware_py/link"),
    ),
    Subject(
        "estimator",
        tuple(f"firmware_py/inference/{name}.py"
              for name in ("estimator", "compiled_observer", "fmu_instance", "golden")),
        ("tests/firmware_py/inference", "tests/fmu/test_tip_bundle.py"),
        slow=True,
    ),
    Subject(
        "guard",
        ("firmware_py/inference/predictor.py", "firmware_py/inference/batch_prediction.py",
         "firmware_py/safety/estimate_trust.py", "models/predictor/guarded_tip.py",
         "models/predictor/interval.py"),
        ("tests/firmware_py/inference", "tests/firmware_py/goals/test_tip_feedback.py",
         "tests/models/predictor"),
    ),
    Subject(
        "goals",
        ("firmware_py/goals/*.py",),
        ("tests/firmware_py/goals",),
    ),
    Subject(
        "imports",
        ("models/trials/checks/*.py", "!models/trials/checks/verdict.py"),
        ("tests/models/trials/checks", "tests/models/trials/recordings/test_wrong_imports.py"),
    ),
    Subject(
        "plant",
        ("models/plant/compose.py", "models/plant/observer.py", "models/plant/plant.py"),
        tuple(f"tests/models/plant/test_{part}.py" for part in ("plant", "compose", "observer")),
        slow=True,
    ),
    Subject(
        "gap",
        ("models/gap/decision/*.py", "models/gap/search/*.py"),
        tuple(f"tests/models/gap/test_{part}.py" for part in (
            "decision", "held_out", "naming", "search",
        )),
    ),
    Subject("fmu", ("fmu/*.py", "!fmu/__main__.py"), ("tests/fmu",)),
    Subject(
        "fmu-c",
        ("fmu/c/*.c",),
        tuple(f"tests/fmu/test_{part}.py" for part in (
            "calls", "saved_states", "derivatives", "example_motion", "model_exchange", "fmu_math",
        )),
    ),
    Subject(
        "timing",
        ("hil/sil/timing_verdict.py", "hil/sil/tick_budget.py"),
        ("tests/hil/sil/test_timing_verdict.py",),
    ),
)  # fmt: skip
