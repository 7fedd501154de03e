"""Small build directories made by the commands' own code: a toy link, three seconds of SIL."""

import io
import json
import shutil
from contextlib import redirect_stdout
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.servo_models import MODELS
from firmware_py.goals.tip_plan import PayloadPlan, TipPlan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.link.link_facts import STUDY_FACTS
from fmu.fmu_checker import check_fmu
from hil.emulator.physics import build_twin
from hil.report.plans_page import PlannedRun, plans_page
from hil.sil import SilOptions, run_sil
from models.bundle.train import name_tests
from models.gap.decision.certainty import Answers
from models.gap.report.gap_json import (
    FittedValue,
    GapDocument,
    HeldOutSummary,
    NamedEffect,
    NamingEvidence,
    NoiseFloorSummary,
    PlantErrors,
    RejectedEffect,
    SignalFloor,
    SignalGap,
    WrittenPlant,
)
from models.gap.residuals.localisation import GapRegion
from models.gap.settings import DEFAULT_SETTINGS
from models.plant.identification.evaluation import evaluate_plant
from models.plant.plant import NOMINAL, read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.predictor.fallback import fit_fallback
from models.shared.pages import write_page
from models.study.document import write_study
from models.study.study import run_study
from models.trials.files import write_trial
from models.trials.trial import TrialSet

COMMANDS = [
    "dropstitch simulate --out build/trials --dof 1 2 --seed 1",
    "dropstitch train build/trials --dof 1 --plant build/plant.json --out build/bundle_1dof",
    "dropstitch report build build --out build/report.html",
]


def with_phase(trials, phase_2_rad):
    """The same trials, labelled with another phase of joint 2."""
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
    training, held_out = toy_trials(2, payloads_kg=(0.0, 2.0)).split()
    one, _ = toy_trials(1).split()
    of_phases = {
        "study_2dof_phase0": (training, tuple(held_out)),
        "study_2dof_phase90": (with_phase(training, 1.5708), tuple(with_phase(held_out, 1.5708))),
    }
    (trained_0, tests_0), (trained_90, tests_90) = of_phases.values()
    pooled = (TrialSet((*trained_0, *trained_90)), (*tests_0, *tests_90))
    for name, (trained, tests) in {**of_phases, "bundle_2dof": pooled}.items():
        fallback = fit_fallback(trained, CompiledModel(toy_observer(2)))
        study = run_study(fallback, name_tests(trained, tests), one)
        (directory / name).mkdir(exist_ok=True)
        write_study(directory / name / "study.json", study)
    few = TrialSet((*held_out[:1], *one[:1]))
    (directory / "evaluate_unseen_20deg.json").write_bytes(
        msgspec.json.encode(evaluate_plant(read_plant(), few))
    )
    twin = build_twin(NOMINAL, 1, directory)
    report = check_fmu(twin)
    (directory / "check_twin_1dof.json").write_text(json.dumps(report.data()))
    options = SilOptions(
        bundle=ModelBundle.load(toy_bundle), model=MODELS[54024], out=directory / "sil_1dof",
        fmu=twin, line="virtual", seconds=3.0,
    )  # fmt: skip
    run_sil(options).write()
    (directory / "commands.log").write_text("\n".join([COMMANDS[0], *COMMANDS]) + "\n")
    return directory


@pytest.fixture(scope="session")
def page(build):
    """Path of the report of that directory."""
    command(["report", "build", str(build)])
    return build / "report.html"


def as_if_by(plant, trials):
    """The same trials with angle, current and tip as a plant simulates them."""
    compiled = CompiledModel(plant.step_model(1, "twin"))
    outputs = names(compiled.model.outputs)
    result = []
    for trial in trials:
        y = run_trial(compiled, trial)
        simulated = {s: y[:, k] for k, s in enumerate(outputs) if s in trial.columns}
        result.append(replace(trial, columns={**trial.columns, **simulated}))
    return TrialSet(tuple(result))


def diagnosis():
    """A gap document that names softening."""
    signals = {"angle_1_rad": "rad", "current_1_a": "A", "tip_x_m": "m", "tip_z_m": "m"}
    levels = {
        "phase": ("1/8", "2/8"),
        "payload": ("0 kg", "2 kg"),
        "stroke": ("way out to negative angles", "return from positive angles"),
        "band": ("0 to 0.3 Hz", "0.3 to 0.8 Hz"),
    }
    regions = tuple(
        GapRegion(signal, factor, level, size, 0.0, 0.0, size > 1)
        for factor, pair in levels.items()
        for signal in signals
        for level, size in zip(pair, (0.8, 12.3), strict=True)
    )
    parameters = {"softening_share": FittedValue(0.19, "1", 0.01, 0.0)}
    effect = NamedEffect(
        effect="stiffness_softening", joint=None, parameters=parameters,
        evidence=NamingEvidence(40.0, 25.0, 0.05, 1.1), look_alikes=(),
    )  # fmt: skip
    errors = {
        rms: {s: SignalGap(rms, unit, rms / 1e-3) for s, unit in signals.items()}
        for rms in (1e-2, 1e-3)
    }
    return GapDocument(
        schema=GapDocument.VERSION, verdict="closed", gap_left_fraction=0.1,
        separation_of_nothing=25.0, headline="Missing: stiffness softening 19 ± 1 %.",
        probabilities=Answers(0.0, 0.98, 0.02),
        noise_floor=NoiseFloorSummary(True, dict.fromkeys(signals, SignalFloor(1e-3, 0.0, 1e-3))),
        sentence="The tip (x) differs most.", located=(), map=regions, named=(effect,),
        rejected=(RejectedEffect("load_dependent_friction", 7.0, "noise"),),
        written=WrittenPlant(("stiffness_softening",), parameters),
        held_out=HeldOutSummary(("repetitions",), 0.2), settings=DEFAULT_SETTINGS,
        before=PlantErrors(errors[1e-2], errors[1e-2]),
        after=PlantErrors(errors[1e-3], errors[1e-3]),
    )  # fmt: skip


@pytest.fixture(scope="session")
def gap_build(build, toy_trials, toy_bundle, tmp_path_factory):
    """What is built around a diagnosis; its trials are those of the improved plant itself."""
    directory = tmp_path_factory.mktemp("gap")
    before = read_plant(NOMINAL)
    after = before.with_effects("stiffness_softening").with_values({"softening_share": 0.19})
    (directory / "found").mkdir()
    after.write(directory / "found" / "plant.json")
    trials = as_if_by(after, toy_trials(1, amplitudes_deg=(30,), payloads_kg=(0.0, 2.0)))
    sealed = as_if_by(
        after, toy_trials(1, amplitudes_deg=(20,), trials=(1,), payloads_kg=(0.0, 2.0))
    )
    paths = {name: [write_trial(t, directory / name) for t in of]
             for name, of in (("trials", trials), ("sealed", sealed))}  # fmt: skip
    (directory / "found" / "gap.json").write_bytes(msgspec.json.encode(diagnosis()))
    for variant, plant in {
        "before": NOMINAL,
        "after": directory / "found" / "plant.json",
    }.items():
        fmu = directory / f"{variant}.fmu"
        command(["fmu", "build", str(toy_bundle), "--plant", str(plant), "--out", str(fmu)])
        for kg, trial in zip(("0", "2"), paths["sealed"], strict=True):
            name = directory / f"fmpy_{variant}_{kg}"
            options = ["--trial", str(trial), "--out", str(name), "--json"]
            with pytest.MonkeyPatch.context() as patch:  # the page does not show this drawing
                patch.setattr("fmu.fmpy_run.FmuRun.plot", lambda _: None)
                patch.setattr("models.shared.drawing.save_svg", lambda *_: None)
                output = command(["fmu", "simulate", str(fmu), *options])
            name.with_suffix(".json").write_text(output)
        for kg in ("0", "2"):
            shutil.copytree(build / "sil_1dof", directory / f"sil_{variant}_{kg}")
    output = command(["fmu", "check", str(fmu), "--json"])
    (directory / "check_twin_1dof.json").write_text(output)
    return directory


def command(arguments):
    """Output of a command."""
    with redirect_stdout(io.StringIO()) as output:
        assert main(arguments) == 0
    return output.getvalue()


@pytest.fixture(scope="session")
def gap_page(gap_build):
    """Path of the page about that directory."""
    out = gap_build / "report.html"
    command(["report", "gap", str(gap_build), "--plant", str(NOMINAL), "--out", str(out),
             "--hide", "stiffness_softening=0.2"])  # fmt: skip
    return out


ROWS = 60
PATH = tuple(np.sin(np.linspace(0.0, 2.0 * np.pi, ROWS)).tolist())


def plan_of(dof):
    columns = (PATH,) * dof
    payload = PayloadPlan(
        payload_kg=1.0, goals_rad=columns, tip_m=columns, current_a=columns, residual_rms_m=0.0,
        rigid_rms_m=0.05, expected_rms_m=0.0,
    )  # fmt: skip
    return TipPlan(
        schema=1, path="circle", method="inverse", dof=dof, period_s=0.017, rest_s=0.017,
        start_row=5, end_row=50, drawn=((5, 50),), desired_m=columns, payloads=(payload,),
        payload_rate_kg_s=0.5, plant_error_rms_m=None, plant_sha256="", bundle_sha256="",
        link=STUDY_FACTS,
    )  # fmt: skip


def run_of(dof, knowledge, payload_kg, error_m):
    """Run of a plan whose tip is everywhere `error_m` off its path."""
    plan = plan_of(dof)
    tip_m = plan.desired_tip_m() + error_m / np.sqrt(dof)
    return PlannedRun(dof, knowledge, payload_kg, plan, tip_m, error_m, error_m)


@pytest.fixture(scope="session")
def runs():
    """Runs of plans with one and two joints, two payloads, and every knowledge of them."""
    return [
        run_of(dof, knowledge, payload_kg, error_m * (1 + payload_kg))
        for dof in (1, 2)
        for payload_kg in (0.0, 1.0)
        for knowledge, error_m in (("rigid", 0.05), ("known", 0.001), ("unknown", 0.004))
    ]


@pytest.fixture(scope="session")
def plans_html(runs, tmp_path_factory):
    """Path of the page of plans."""
    path = tmp_path_factory.mktemp("plans") / "plans.html"
    write_page(path, plans_page(runs))
    return path
