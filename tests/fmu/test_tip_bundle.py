"""Bundle with a chosen predictor: what runs with and without the observer."""

import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.fmu_instance import FmuInstance
from firmware_py.inference.golden import read_golden, verify_equal
from firmware_py.inference.manifest import write_manifest
from firmware_py.inference.range_check import RangeWatch
from models.predictor.document import read_predictors
from models.trials.files import read_trial, write_trial


@pytest.fixture(scope="module")
def trained(toy_trials, tmp_path_factory):
    """Bundle of toy trials on the nominal plant, with a second motion, without the observer."""
    root = tmp_path_factory.mktemp("tip")
    for trial in toy_trials(1, amplitudes_deg=(30,), payloads_kg=(0.0, 1.0)):
        write_trial(trial, root / "trials")
    for trial in toy_trials(1, amplitudes_deg=(25,), trials=(1,), payloads_kg=(0.5,), seed=3):
        meta = msgspec.structs.replace(trial.meta, motion="multisine")
        write_trial(replace(trial, meta=meta), root / "further")
    arguments = [
        "train", str(root / "trials"), "--dof", "1", "--out", str(root / "bundle"),
        "--plant", "models/plant/nominal.toml", "--motions", str(root / "further"),
        "--compare",
    ]  # fmt: skip
    assert dropstitch(arguments) == 0
    return root


def test_the_bundle_says_what_was_compared_and_why(trained):
    bundle = trained / "bundle"
    document = read_predictors(bundle / "predictors.json")
    assert document.motions == ("multisine", "sinusoid") and document.payload_kg == (0.0, 0.5, 1.0)
    assert document.chosen in document.candidates and len(document.candidates) == 6
    assert read_manifest(bundle).predictor == document.chosen
    card = (bundle / "MODEL_CARD.md").read_text()
    assert document.reason in card and "left out in turn" in card
    for entry in document.candidates.values():
        assert {"stiffness_x_0.8", "stiffness_x_1.2"} < set(entry.tests)
    assert "study.json" not in read_manifest(bundle).files  # without --study


@pytest.fixture(scope="module")
def observed(trained, tmp_path_factory):
    """That bundle with its observer."""
    bundle = shutil.copytree(trained / "bundle", tmp_path_factory.mktemp("observed") / "bundle")
    assert dropstitch(["fmu", "build", str(bundle), "--unit", "observer"]) == 0
    return bundle


def test_without_the_observer_the_polynomial_runs_and_with_it_the_chosen_one(trained, observed):
    before = ModelBundle.load(trained / "bundle")
    assert before.predictor.wanted == () and before.manifest.estimator == "lagged"
    assert set(read_predictors(observed / "predictors.json").runtimes) == {"onnx", "compiled"}
    after = ModelBundle.load(observed, runtime="onnx")  # the golden ticks are replayed through both
    assert {"tip_x_m", "innovation_1_a", "payload_kg"} <= set(after.predictor.wanted)
    sample = np.zeros(1), np.zeros(1)
    estimate = after.estimator.update(*sample, 0.017)
    answer = after.predictor.predict(*sample, estimate.di, estimate.signals)
    assert answer.tip_m[2] == pytest.approx(1.0, abs=0.05)
    old = answer.half_width_m.copy()
    late = after.predictor.predict(*sample, estimate.di, estimate.signals, 0.05)
    assert (late.half_width_m >= old).all()


@pytest.mark.parametrize("runtime", ["onnx", "compiled"])
def test_training_counts_the_rows_out_of_range_as_the_robot_does(trained, observed, runtime):
    bundle, rows, outside = ModelBundle.load(observed, runtime=runtime), 0, 0
    watch = RangeWatch(bundle)
    for path in sorted((trained / "trials").glob("*_2.csv")):
        trial = read_trial(path)
        bundle.estimator.reset()
        for angle_rad, current_a in zip(trial.angle_rad, trial.current_a, strict=True):
            estimate = bundle.estimator.update(angle_rad, current_a, trial.step_s)
            answer = watch.predict(angle_rad, current_a, estimate.di, estimate.signals)
            rows, outside = rows + 1, outside + (not answer.in_range)
    document = read_predictors(observed / "predictors.json")
    score = document.candidates[document.chosen].tests["trial_2"]["all"]
    assert score.rows == rows and 0 < outside == round((1 - score.in_range) * rows)
    expected, counted = document.out_of_range["trial_2"], watch.reasons()
    same = {"angle_1_rad", "current_1_a", "di", "innovation_1_a"}
    assert [(i.name, i.ticks) for i in counted.inputs if i.name in same] == [
        (i.name, i.ticks) for i in expected.inputs if i.name in same
    ]
    if runtime == "onnx":
        assert (expected.wide_ticks, expected.other_ticks) == (
            counted.wide_ticks, counted.other_ticks,
        )  # fmt: skip
    assert f"{outside} of {rows} rows" in (observed / "MODEL_CARD.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_observer_passes_its_check_and_takes_the_age_of_a_sample_as_zero(observed, capsys):
    assert dropstitch(["fmu", "check", str(observed / "observer.fmu")]) == 0
    assert "NOT sound" not in capsys.readouterr().out


def answers(models, samples, ages_s):
    """Tip, range and half width after each sample, and again for an older one."""
    models.estimator.reset()
    found = []
    for (angle_rad, current_a), age_s in zip(samples, ages_s, strict=True):
        sample = np.array([angle_rad]), np.array([current_a])
        estimate = models.estimator.update(*sample, 0.017)
        for age in (0.0, age_s):
            answer = models.predictor.predict(*sample, estimate.di, estimate.signals, age)
            found.append([*answer.tip_m, answer.in_range, *answer.half_width_m])
    return np.array(found)


def test_compiled_and_onnx_give_the_same_answers_also_to_what_is_old_or_no_number(observed):
    onnx, compiled = (ModelBundle.load(observed, runtime=runtime) for runtime in ("onnx", None))
    assert (onnx.runtime, compiled.runtime) == ("onnx", "compiled")
    assert compiled.signal_names == ("innovation_1_a",), "feedback of the tip ends its trust by it"
    assert "innovation_1_a" in onnx.signal_names
    k = np.arange(40)
    samples = np.column_stack([0.2 * np.sin(0.1 * k), 0.8 * np.cos(0.1 * k)])
    samples[20, 1] = np.nan
    ages_s = 0.017 * (k % 3)
    one, other = answers(onnx, samples, ages_s), answers(compiled, samples, ages_s)
    nan = np.isnan(samples).any(axis=1).repeat(2)
    assert nan.sum() == 2 and not one[nan, 3].any() and np.isnan(one[nan, :3]).all()
    assert np.allclose(one[~nan], other[~nan], rtol=0, atol=1e-9)
    assert np.isnan(other[nan, :3]).all()
    assert (other[3::6, 4:] > other[2::6, 4:]).all()  # an old sample has a wider interval
    early = [m.predictor for m in (onnx, compiled) if not m.estimator.reset()]
    assert early[1].predict(np.zeros(1), np.zeros(1), 0.0).tip_m[2] == pytest.approx(1.0, abs=0.05)


def test_a_sample_that_the_compiled_observer_has_not_had_is_refused(observed):
    compiled = ModelBundle.load(observed, runtime="compiled")
    compiled.estimator.update(np.zeros(1), np.zeros(1), 0.017)
    with pytest.raises(InputError, match="update has not had"):
        compiled.predictor.predict(np.full(1, 0.1), np.zeros(1), 0.0)
    angle_rad, current_a = np.linspace(0.0, 0.3, 30), np.linspace(0.0, 0.9, 30)
    assert len(np.unique(compiled.predict_many(angle_rad, current_a).tip_m[:, 0])) == 30


def test_answers_that_differ_are_refused(observed):
    golden = read_golden(observed / "golden.npz", 1)
    onnx, compiled = (
        ModelBundle.load(observed, runtime=runtime) for runtime in ("onnx", "compiled")
    )
    compiled.assume_payload(2.5)
    assert compiled.estimator.update(np.zeros(1), np.zeros(1), 0.017).payload_kg == 2.5
    pair = (onnx.estimator, onnx.predictor), (compiled.estimator, compiled.predictor)
    with pytest.raises(InputError, match=r"tick \d+: \w+ is .* compiled and .* by onnxruntime"):
        verify_equal(golden, *pair, observed)


def test_without_a_compiled_predictor_onnxruntime_runs(trained, observed, monkeypatch):
    assert ModelBundle.load(trained / "bundle").runtime == "onnx"
    with pytest.raises(InputError, match="has no observer"):
        ModelBundle.load(trained / "bundle", runtime="compiled")
    monkeypatch.setattr(FmuInstance, "ticks", False)
    assert ModelBundle.load(observed).runtime == "onnx"
    with pytest.raises(InputError, match="holds no compiled predictor"):
        ModelBundle.load(observed, runtime="compiled")


def test_a_predictor_without_its_observer_is_refused_in_one_sentence(trained, tmp_path):
    bundle = shutil.copytree(trained / "bundle", tmp_path / "bundle")
    (bundle / "polynomial.onnx").unlink()
    write_manifest(bundle, read_manifest(trained / "bundle"))
    with pytest.raises(InputError, match="needs tip_x_m of an observer that is missing"):
        ModelBundle.load(bundle)


def test_a_trial_is_not_both_trained_on_and_tested(trained, tmp_path, capsys):
    arguments = ["train", str(trained / "trials"), "--dof", "1", "--out", str(tmp_path / "b"),
                 "--plant", "models/plant/nominal.toml", "--motions", str(trained / "further"),
                 "--unseen", str(trained / "further")]  # fmt: skip
    assert dropstitch(arguments) == 2
    assert "is a trial of --motions and a test" in capsys.readouterr().err
