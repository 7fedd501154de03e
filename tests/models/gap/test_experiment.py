"""Motions are ranked by how well they separate rival hypotheses, within the robot's limits."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion, MotionConfig
from firmware_py.safety.limits import Limits
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.nuisance_fit import nuisance_fit_of
from models.gap.experiment.experiment import (
    SEPARATED,
    default_payloads_kg,
    planned_motions,
    rank_motions,
    twin_keeps,
    usual_motions,
)
from models.gap.experiment.rival import (
    HypothesisRecord,
    credible_set,
    fitted_values_of,
    rivals_of,
)
from models.gap.experiment.separation import SeparationModel, planned_trial
from models.gap.report.gap_json import DiagnosisInputs
from models.gap.residuals.fit_parameters import candidate_effects, effect_candidates
from models.gap.residuals.residuals import Residuals
from models.plant.plant import read_plant
from models.plant.simulation.runner import CompiledModel, run_trial
from models.plant.step_model import names
from models.rig.drawn import rig_named
from models.rig.protocol import TrialCase, run_case
from models.trials.files import write_trial
from models.trials.trial import TrialSet
from tests.models.gap.made_documents import document
from tests.models.made_trials import with_columns

# Rival hypotheses


@pytest.mark.parametrize(
    ("hypotheses", "rivals"),
    [
        (
            [(0.4, "creep"), (0.3, "hysteresis"), (0.2, "creep", "cogging"),
             (0.1, "creep", "hysteresis")],
            {("creep",): 0.65, ("hysteresis",): 0.35},
        ),
        ([(0.6, "creep"), (0.4,)], {("creep",): 0.6, (): 0.4}),
        ([(0.98, "creep"), (0.015, "cogging"), (0.005, "stiction")],
         {("creep",): 0.98, ("cogging",): 0.015}),
    ],
    ids=["a set gives its probability to those that it includes", "nothing missing is a rival",
         "unlikely ones are dropped but for two"],
)  # fmt: skip
def test_rivals_of_hypotheses(hypotheses, rivals):
    rows = rivals_of([HypothesisRecord(tuple(e), p, {}) for p, *e in hypotheses])
    assert {r.effects: r.probability for r in rows} == pytest.approx(rivals)


def test_the_credible_set_is_the_smallest_of_95_per_cent():
    probabilities = {"creep": 0.7, "cogging": 0.26, "stiction": 0.04}
    rows = rivals_of([HypothesisRecord((e,), p, {}) for e, p in probabilities.items()])
    assert [r.effects for r in credible_set(rows)] == [("creep",), ("cogging",)]


def test_a_document_without_probabilities_is_refused():
    with pytest.raises(InputError, match="no hypothesis a probability"):
        rivals_of([HypothesisRecord((e,), 0.0, {}) for e in ("creep", "cogging")])


@pytest.mark.parametrize(
    ("effects", "changes", "values"),
    [
        (("coulomb_friction",), (2.0, 2.0), {"coulomb_friction": 2.0}),
        (("coulomb_friction:2",), (0.0, 3.0), {"coulomb_friction:2": 3.0}),
        (
            ("coulomb_friction", "coulomb_friction:1"), (5.0, 2.0),
            {"coulomb_friction": 2.0, "coulomb_friction:1": 3.0},
        ),
    ],
)  # fmt: skip
def test_the_values_of_a_hypothesis_become_those_of_its_candidates(effects, changes, values):
    plant = read_plant()
    candidates = effect_candidates(plant, "coulomb_friction", 2).values()
    fit_parameters = [q for parameters in candidates for q in parameters]
    friction = ("coulomb_friction_1_nm", "coulomb_friction_2_nm")
    parameters = {n: plant.parameters[n].value + c for n, c in zip(friction, changes, strict=True)}
    fitted = fitted_values_of(HypothesisRecord(effects, 1.0, parameters), plant, fit_parameters)
    moved = {q.effect: v for q, v in zip(fit_parameters, fitted, strict=True) if v}
    assert moved == pytest.approx(values)


# Ranking

LIMITS = Limits(rate_rad_s=1.0, current_a=6.0)
RIVALS = (
    HypothesisRecord(("encoder_offset",), 0.6, {"encoder_offset_1_rad": 0.02}),
    HypothesisRecord(("marker_frame_tilt",), 0.4, {"marker_frame_tilt_rad": -0.02}),
)


@pytest.fixture(scope="module")
def truth(plant):
    rich = plant.with_effects("encoder_offset", "marker_frame_tilt")
    return rich.with_values({"encoder_offset_1_rad": 0.02})


@pytest.fixture(scope="module")
def recorded(truth, trials_of):
    """Trial of the truth without noise and variation."""
    return TrialSet((as_measured(truth, trials_of(truth, 3, (1.0,), 1)[0]),))


@pytest.fixture(scope="module")
def experiment(plant, recorded):
    return rank_motions(RIVALS, plant, recorded, LIMITS, (1.0,))


def as_measured(plant, trial):
    compiled = CompiledModel(plant.step_model(1, "twin"))
    columns = dict(zip(names(compiled.model.outputs), run_trial(compiled, trial).T, strict=True))
    return with_columns(trial, **columns)


def refitted(plant, trials, fit_parameters, floor):
    """d′ that remains after every parameter of the second rival was fitted to trials."""
    estimator = GaussNewton(Residuals(plant, trials, fit_parameters), floor)
    estimator.means = [np.zeros_like(mean) for mean in estimator.means]
    start = estimator.at(fitted_values_of(RIVALS[1], plant, fit_parameters))
    return np.sqrt(2 * estimator.fit(start, np.ones(len(start.values), dtype=bool)).cost)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "payload_kg"), [("triangle", 0.0), ("multisine", 2.0)])
def test_the_separation_is_what_a_refit_to_all_trials_leaves(
    plant, truth, recorded, kind, payload_kg
):
    nuisance = nuisance_fit_of(plant, recorded.trials, candidate_effects(plant), False)
    model = SeparationModel(nuisance, RIVALS, [(0, 1)])
    meta = recorded[0].meta
    motion = Motion(kind, meta.amplitude_rad, 2 * meta.period_s)
    run = model.planned_run(motion, payload_kg)
    (before,), (separation,) = model.before, model.separations(run)

    planned = as_measured(truth, planned_trial(recorded[0], motion, payload_kg))
    fit_parameters = model.estimator.residuals.fit_parameters
    every = [q for q in fit_parameters if q.effect in ("", "marker_frame_tilt")]
    both = every + [replace(q, trial=1) for q in every if q.trial == 0]
    floor, further = model.estimator.floor, model.planned_floor(run).formulation
    assert before == pytest.approx(refitted(plant, recorded.trials, every, floor), rel=0.05)
    floor = replace(floor, formulation=floor.formulation | further)
    exact = refitted(plant, [recorded[0], planned], both, floor)
    assert separation == pytest.approx(exact, rel=0.05)


def test_motions_are_ranked_by_what_they_separate_and_the_payload_is_swapped(experiment, recorded):
    (before,) = experiment.before
    separations = [r.separations[0] for r in experiment.ranked]
    assert separations == sorted(separations, reverse=True) and separations[-1] >= before
    assert bool(experiment.together) == (separations[0] < SEPARATED)
    assert default_payloads_kg(recorded) == (1.0, 2.0)


def test_a_recorded_motion_is_offered_with_another_payload_alone(recorded):
    size = recorded[0].meta.amplitude_rad, recorded[0].meta.period_s

    def sinusoids(limits):
        planned = planned_motions(recorded, (1.0, 2.0), limits)
        rows = [((m.amplitude_rad, m.period_s), p) for m, p in planned if m.kind == "sinusoid"]
        return {p for motion, p in rows if motion == size}, len(planned)

    wide = msgspec.structs.replace(LIMITS, rate_rad_s=2.0, acceleration_rad_s2=1e3)
    offered, count = sinusoids(wide)
    refused, fewer = sinusoids(LIMITS)  # too fast
    assert offered == {2.0} and not refused
    assert fewer < count


def test_usual_motions_are_those_that_any_servo_may_run(make_trial):
    def offered(period_s):
        trial = make_trial(np.zeros((80, 1)), amplitude_rad=0.52, period_s=period_s)
        return {(motion.kind, kg) for motion, kg in usual_motions(TrialSet((trial,)))}

    # Free decay begins with 6 rad/s, which a servo without a watchdog may not run.
    kinds = ("sinusoid", "multisine", "triangle", "steps")
    every = {(kind, payload_kg) for kind in kinds for payload_kg in (1.0, 2.0)}
    assert offered(4.352) == every - {("sinusoid", 1.0)}  # that of the trial
    with pytest.raises(InputError, match="no motion to try"):
        offered(0.05)


@pytest.mark.parametrize(
    ("signal", "values", "keeps"),
    [
        ("current_1_a", (0.0, 5.0), True),
        ("current_1_a", (0.0, -5.2), False),
        ("angle_1_rad", (0.0, 0.18), False),
        ("tip_z_m", (1.010, 1.0105), True),  # rests within the margin: half of the rest is allowed
        ("tip_z_m", (1.010, 1.0115), False),
        ("tip_z_m", (1.013, 1.013), False),
    ],
)
def test_a_twin_keeps_its_limits_with_a_margin(make_trial, signal, values, keeps):
    limits = Limits(current_a=6.0, tip_min_m=(-1.0, -1.0, 0.5), tip_max_m=(1.0, 1.0, 1.012))
    rest = {"current_1_a": 0.0, "angle_1_rad": 0.0, "tip_x_m": 0.0, "tip_y_m": 0.0, "tip_z_m": 0.9}
    outputs = {name: np.full(80, value) for name, value in rest.items()}
    outputs[signal] = np.repeat(values, 40)
    assert twin_keeps(limits, outputs, make_trial(np.zeros((80, 1)))) is keeps


@pytest.mark.parametrize(
    ("rivals", "payloads_kg", "limits", "sentence"),
    [
        (RIVALS[:1], (), {}, "no two hypotheses"),
        (RIVALS, (50.0,), {}, "choose 0 to 2 kg"),
        (RIVALS, (np.nan,), {}, "--payloads nan"),
        (RIVALS, (), {"angle_rad": (0.2, 0.6)}, "no motion to try"),
        (RIVALS, (), {"rate_rad_s": 0.01}, "no motion to try"),
        (RIVALS, (2.0,), {"current_a": 1.5}, "none of the motions in simulation"),
        ((msgspec.structs.replace(RIVALS[0], effects=("slip",)), RIVALS[1]), (), {}, "'slip'"),
    ],
)
def test_what_nothing_can_be_ranked_for_is_refused(
    plant, recorded, rivals, payloads_kg, limits, sentence
):
    limits = msgspec.structs.replace(LIMITS, **limits)
    with pytest.raises(InputError, match=sentence):
        rank_motions(rivals, plant, recorded, limits, payloads_kg)


# The command

HYPOTHESES = (
    HypothesisRecord(("dead_time",), 0.6, {"dead_time_1_s": 0.02}),
    HypothesisRecord(("sync_offset",), 0.4, {"sync_offset_s": -0.02}),
)


@pytest.fixture(scope="module")
def rig_trial():
    case = TrialCase(Motion(amplitude_rad=0.3, period_s=2.6), 1.0, trial=1)
    return run_case(rig_named("default"), case)


@pytest.fixture
def diagnosis(rig_trial, tmp_path):
    """Function that writes plant, trial and the document of a diagnosis, and returns its file."""

    def write(directory, trials_sha256="", plant_sha256=""):
        write_trial(rig_trial, directory)
        plant = tmp_path / "plant.toml"
        read_plant().write(plant)
        inputs = DiagnosisInputs(str(plant), plant_sha256, (str(directory),), trials_sha256, 1)
        diagnosed = document(hypotheses=HYPOTHESES, inputs=inputs)
        write_document(tmp_path / "gap.json", diagnosed)
        return tmp_path / "gap.json"

    return write


def run_command(gap, out, *options):
    return main(
        ["experiment", "--gap", str(gap), "--config", "robot.toml", "--out", str(out), *options]
    )


@pytest.mark.slow
def test_the_command_writes_the_best_motion_and_its_page(diagnosis, tmp_path, capsys):
    out = tmp_path / "motion.toml"
    gap = diagnosis(tmp_path / "trials")
    assert run_command(gap, out, "--payloads", "1", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    first = result["ranking"][0]
    motion = MotionConfig().with_motion(str(out)).motion(1)
    assert (motion.kind, motion.period_s) == (first["kind"], first["period_s"])
    assert first["payload_kg"] == 1.0
    assert first["separation"].keys() == result["separation_now"].keys()
    page = (tmp_path / "motion.html").read_text()
    assert "dead time" in page and "All motions" in page


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--hide", "creep=0.1"], "--repeat"),
        ([], "none.json"),
        (["--seed", "-1"], "--seed -1: is out of range; choose 0 to 4294967295"),
        (["--seed", "4294967296", "--repeat"], "--seed 4294967296: is out of range"),
    ],
)
def test_wrong_options_are_refused(tmp_path, capsys, options, sentence):
    assert run_command(tmp_path / "none.json", tmp_path / "motion.toml", *options) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and sentence in error
    assert not (tmp_path / "motion.toml").exists()


CHANGED = "0" * 64


@pytest.mark.parametrize(
    ("hashes", "out", "options", "sentence"),
    [
        ({"trials_sha256": CHANGED}, "m.toml", [], "are not the trials of this diagnosis"),
        ({"plant_sha256": CHANGED}, "m.toml", [], "is not the plant of this diagnosis"),
        ({}, "gap.json", [], "no TOML file"),
        ({}, "m.toml", ["--repeat"], "trials: is not empty; remove it, or name another --out"),
        ({}, "plant.toml", ["--repeat"], "is a file that is read; name another file"),
        ({}, "m/trials/TRIAL.toml", ["--repeat"], "is a file that is read; name another file"),
    ],
)
def test_changed_inputs_are_refused_and_nothing_of_the_diagnosis_is_overwritten(
    diagnosis, rig_trial, tmp_path, capsys, hashes, out, options, sentence
):
    gap = diagnosis(tmp_path / "m" / "trials", **hashes)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert run_command(gap, tmp_path / out.replace("TRIAL", rig_trial.name), *options) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and sentence in error
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
