"""Bundle with a chosen predictor: what runs with and without the observer."""

import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.inference.bundle import ModelBundle, read_manifest, write_manifest
from fmu.__main__ import main as fmu
from models.__main__ import main as models
from models.tip.predictors_document import read_predictors
from models.trials.trial_files import write_trial


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
    ]  # fmt: skip
    assert models(arguments) == 0
    return root


def test_the_bundle_says_what_was_compared_and_why(trained):
    bundle = trained / "bundle"
    document = read_predictors(bundle / "predictors.json")
    assert document.motions == ("multisine", "sinusoid") and document.payload_kg == (0.0, 0.5, 1.0)
    assert document.chosen in document.candidates and len(document.candidates) == 6
    assert read_manifest(bundle).predictor == document.chosen
    card = (bundle / "MODEL_CARD.md").read_text()
    assert document.reason in card and "left out in turn" in card


def test_without_the_observer_the_polynomial_runs_and_with_it_the_chosen_one(trained, tmp_path):
    bundle = shutil.copytree(trained / "bundle", tmp_path / "bundle")
    before = ModelBundle.load(bundle)
    assert before.predictor.wanted == () and before.manifest.estimator == "lagged"
    assert fmu(["build", str(bundle), "--unit", "observer"]) == 0
    after = ModelBundle.load(bundle)  # the golden ticks are replayed through both
    assert {"tip_x_m", "innovation_1_a", "payload_kg"} <= set(after.predictor.wanted)
    sample = np.zeros(1), np.zeros(1)
    estimate = after.estimator.update(*sample, 0.017)
    answer = after.predictor.predict(*sample, estimate.di, estimate.signals)
    assert answer.tip_m[2] == pytest.approx(1.0, abs=0.05)
    old = answer.half_width_m.copy()
    late = after.predictor.predict(*sample, estimate.di, estimate.signals, 0.05)
    assert (late.half_width_m >= old).all()


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
    assert models(arguments) == 2
    assert "is a trial of --motions and a test" in capsys.readouterr().err
