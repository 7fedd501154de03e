"""A small build directory made by the commands' own code: a toy link, three seconds of SIL."""

import json
from dataclasses import replace

import msgspec
import pytest

from firmware_py.bundle import ModelBundle
from firmware_py.servo_models import MODELS
from fmu.check import check_unit
from fmu.stepper import Archive
from fmu.units import parts_inside
from hil import sil
from hil.commands.sil import write_results
from hil.report import write_report
from hil.twin import build_twin
from models.commands.train import name_tests
from models.plant.evaluate import evaluation
from models.plant.plant import NOMINAL, read_plant
from models.study import run_study
from models.trials import TrialSet

COMMANDS = [
    "python -m models simulate --out build/trials --dof 1 2 --seed 1",
    "python -m models train build/trials --dof 1 --plant build/plant.json --out build/bundle_1dof",
    "python -m hil report --build build --out build/report.html",
]


def with_phase(trials, phase_2_rad):
    """The same trials, said to be of another phase of joint 2."""
    return TrialSet(
        tuple(
            replace(t, name=f"{t.name}_ahead",
                    meta=msgspec.structs.replace(t.meta, phase_2_rad=phase_2_rad))
            for t in trials
        )
    )  # fmt: skip


@pytest.fixture(scope="session")
def build(toy_trials, toy_observer, toy_bundle, tmp_path_factory):
    directory = tmp_path_factory.mktemp("build")
    (directory / "bundle_1dof").symlink_to(toy_bundle)
    (directory / "bundle_2dof").mkdir()
    training, held_out = toy_trials(2).split()
    one, _ = toy_trials(1).split()
    study = run_study(training, name_tests(training, tuple(held_out)), toy_observer(2), one)
    both = TrialSet((*training, *with_phase(training, 1.5708)))
    tests = name_tests(both, (*held_out, *with_phase(held_out, 1.5708)))
    pooled = run_study(both, tests, toy_observer(2), one)
    (directory / "bundle_2dof" / "study.json").write_text(json.dumps(pooled.document))
    around = with_phase(training, 1.5708)
    apart = run_study(around, name_tests(around, tuple(with_phase(held_out, 1.5708))),
                      toy_observer(2), one)  # fmt: skip
    for name, of_phase in (("phase0", study), ("phase90", apart)):
        (directory / f"study_2dof_{name}").mkdir()
        text = json.dumps(of_phase.document)
        (directory / f"study_2dof_{name}" / "study.json").write_text(text)
    plant = read_plant()
    few = TrialSet((*held_out[:1], *one[:1]))
    (directory / "evaluate_unseen_20deg.json").write_text(json.dumps(evaluation(plant, few)))
    unit = build_twin(NOMINAL, 1, directory)
    with Archive(unit) as archive:
        report = check_unit(archive, parts_inside(archive.directory / "resources"))
    (directory / "check_twin_1dof.json").write_text(json.dumps(report.data()))
    options = sil.Options(
        bundle=ModelBundle.load(toy_bundle), model=MODELS[54024], out=directory / "sil_1dof",
        unit=unit, line="virtual", seconds=3.0,
    )  # fmt: skip
    write_results(sil.run(options), options)
    (directory / "commands.log").write_text("\n".join([COMMANDS[0], *COMMANDS]) + "\n")
    return directory


@pytest.fixture(scope="session")
def page(build):
    """Path of the report of that directory."""
    out = build / "report.html"
    write_report(build, out)
    return out
