"""Trials of the rig: the contract, reproducibility and the options of `simulate`."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.console import BAD_INPUT, DONE
from models.rig.overview import draw_overview
from models.rig.parameters import RIG_TOML, named_structures
from models.rig.protocol import run_case
from models.shared.kinematics import rigid_tip_m
from models.trials.files import read_trials

SHORT = ["--amplitude-deg", "5", "--period", "0.5", "--payloads", "0.5", "--trials", "1"]


def simulate(out, *options):
    return main(["simulate", "--out", str(out), *SHORT, *options])


@pytest.fixture
def undrawn(monkeypatch):
    """No overview is drawn: it costs more than a trial."""
    monkeypatch.setattr("models.rig.overview.draw_overview", lambda directory: directory)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("rig")
    assert simulate(out, "--workers", "1", "--dof", "1", "2", "--seed", "3") == DONE
    return out


def files(directory):
    return {p.name: p.read_bytes() for p in directory.glob("*.csv")}


def test_trials_meet_the_contract(written, rigid_markers):
    trials = read_trials(written)
    assert [t.name for t in trials] == [
        "dof1_payload0.5_trial1_sinusoid_5deg_period0.5s",
        "dof2_payload0.5_trial1_sinusoid_5deg_period0.5s",
    ]
    for trial in trials:
        assert trial.step_s == pytest.approx(0.017)
        assert len(trial) == trial.meta.rest_samples + round(2 * 0.5 / 0.017)
        assert trial.meta.source == "rig"
        np.testing.assert_allclose(trial.tip_m, trial.markers_m[:, 12:].mean(axis=1))
        for counts in (trial.angle_rad / (2 * np.pi / 501_923), trial.current_a / (33.0 / 2048)):
            np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        # The whole link at rest, and its first quarter in motion, near the first mode.
        error = trial.markers_m - rigid_markers(trial.angle_rad)
        assert np.max(np.abs(error[:60])) < 0.01
        assert np.sqrt(np.mean(error[:, :4] ** 2)) < 0.025
        assert np.ptp(trial.tip_m[:, 0]) > 0.1  # it did move
        # The noise of the markers is 0.15 mm; drift over the rest stays below a millimetre.
        rest = slice(trial.meta.rest_samples)
        assert np.max(np.abs(trial.markers_m[rest] - trial.markers_m[rest].mean(axis=0))) < 1.2e-3
        assert not np.any(trial.goal_rad[: trial.meta.rest_samples + 1])
        assert np.max(np.abs(trial.angle_rad[rest])) < 2e-3
    overview = (written / "overview.svg").read_bytes()
    assert overview.startswith(b"<?xml")
    assert draw_overview(written).read_bytes() == overview
    record = json.loads((written / "rig_conditions.json").read_text())
    assert set(record["trials"]) == {t.name for t in trials}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits_in_any_number_of_processes(written, tmp_path, undrawn):
    options = ("--dof", "1", "2", "--seed", "3", "--workers", "2", "--trials", "2")
    assert simulate(tmp_path, *options) == DONE
    assert files(written).items() <= files(tmp_path).items()


def test_seeds_and_repetitions_differ(short, short_case, default_trial):
    for case in (short_case(seed=1), short_case(trial=2)):
        other = run_case(short, case)
        assert np.all(np.std(other.tip_m - default_trial.tip_m, axis=0) > 1e-5)


def test_markers_and_encoder_share_one_clock(parameters, short_case):
    """Without delay, noise and play, and hardly any bend, the tip is where the angle says."""
    stiff = parameters.changed(
        **{f"variation.{n}": 0.0 for n in ("mocap_delay_s", "frame_shift_m", "eccentricity_m")},
        **{f"sensor.{n}": 0.0 for n in ("mocap_jitter_s", "marker_noise_m")},
        **{"servo.backlash_rad": 0.0, "servo.load_friction_share": 0.0, "world.pause_s": 0.2,
           "stiffness.prebend_rad": 0.0, "link.mass_kg": 0.01, "link.tip_mass_kg": 0.001},
    )  # fmt: skip
    trial = run_case(stiff, short_case(dof=1, payload_kg=0.0, period_s=1.5))
    rigid_m, rows = rigid_tip_m(trial.angle_rad, 0.06, 0.95), slice(90, None)
    speed = np.gradient(rigid_m[:, 0], trial.step_s)[rows]
    lag_s = -np.polyfit(speed, (trial.tip_m - rigid_m)[rows, 0], 1)[0]
    assert abs(lag_s) < 3e-4


@pytest.mark.slow
def test_further_trials_join_and_the_same_options_write_the_same_again(written, undrawn):
    before = files(written)
    assert simulate(written, "--workers", "1", "--motion", "multisine", "--seed", "3") == DONE
    assert simulate(written, "--workers", "1", "--dof", "1", "--seed", "3") == DONE
    assert before.items() <= files(written).items()
    assert len(files(written)) == len(before) + 1


@pytest.mark.parametrize(
    "options", [["--seed", "4"], ["--seed", "3", "--hide", "creep=0.1"], ["--rig", "test_b"]]
)
def test_trials_of_other_conditions_are_not_overwritten(written, options, capsys, undrawn):
    before = files(written)
    assert simulate(written, *options) == BAD_INPUT
    assert "other conditions" in capsys.readouterr().err
    assert files(written) == before


def test_rig_and_hidden_effects_are_recorded_beside_the_trial_alone(tmp_path, undrawn):
    assert simulate(tmp_path, "--rig", "test_a", "--hide", "backlash=0.005") == DONE
    record = json.loads((tmp_path / "rig_conditions.json").read_text())
    (conditions,) = record["trials"].values()
    assert conditions["rig"] == "test_a" and conditions["structure"]["hysteresis"] == "dahl"
    assert conditions["hidden"] == {"backlash": 0.005}
    for path in tmp_path.glob("dof*"):
        assert not any(word in path.read_text() for word in ("test_a", "backlash", "dahl"))


@pytest.mark.parametrize(
    "options, message",
    [
        (["--hide", "slop=1"], "choose from coulomb_friction"),
        (["--hide", "backlash=nan"], "finite"),
        (["--hide", "backlash=5"], "outside 0 to 0.1"),
        (["--hide", "creep=0.1", "--hide", "creep=0.2"], "twice"),
        (["--payloads", "50"], "choose 0 to 10"),
        (["--trials", "0"], "--trials 0"),
        (["--amplitude-deg", "120"], "choose 0 to 90"),
        (["--period", "0"], "period_s: is 0"),
        (["--gravity", "0", "0", "0"], "direction"),
        (["--workers", "0"], "--workers 0"),
        (["--rig", "missing.toml"], ", ".join(named_structures())),
    ],
)
def test_wrong_options_get_one_sentence(options, message, tmp_path, capsys, undrawn):
    assert simulate(tmp_path / "out", *options) == BAD_INPUT
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert message in error[0]
    assert not list((tmp_path / "out").glob("*.csv"))


@pytest.mark.slow
def test_a_folding_link_is_reported_across_processes(tmp_path, capsys):
    options = ["--payloads", "9", "10", "--amplitude-deg", "60", "--period", "4", "--workers", "2"]
    assert simulate(tmp_path, *options) == BAD_INPUT
    assert "the link folds" in capsys.readouterr().err


def test_the_file_of_the_rig_is_not_replaced_by_a_trial(tmp_path, capsys):
    rig = tmp_path / "dof1_payload0.5_trial1_sinusoid_5deg_period0.5s.toml"
    rig.write_text(RIG_TOML.read_text())
    assert simulate(tmp_path, "--rig", str(rig)) == BAD_INPUT
    assert "which is read; name another directory" in capsys.readouterr().err
    assert rig.read_text() == RIG_TOML.read_text()
    assert list(tmp_path.iterdir()) == [rig]
