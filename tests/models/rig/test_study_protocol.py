"""Trials of the rig: the contract, reproducibility and the options of `simulate`."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.console import BAD_INPUT, DONE
from models.rig.protocol import run_case
from models.shared.kinematics import rigid_tip_m
from models.trials.files import read_trial, read_trials, write_trial

QUICK = ["--amplitude-deg", "5", "--period", "0.5", "--payloads", "0.5", "--trials", "1"]


def run(out, *options):
    """Exit code of the command, without the overview's drawing, which costs more than a trial."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("models.rig.overview.draw_overview", lambda directory: directory)
        return command(out, "--workers", "1", *options)


def command(out, *options):
    return main(["simulate", "--out", str(out), *QUICK, *options])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("rig")
    assert command(out, "--workers", "1", "--dof", "1", "2", "--seed", "3") == DONE
    return out


def test_trials_keep_the_contract(written):
    trials = read_trials(written)
    assert [t.name for t in trials] == [
        "dof1_payload0.5_trial1_sinusoid_5deg_period0.5s",
        "dof2_payload0.5_trial1_sinusoid_5deg_period0.5s",
    ]
    for trial in trials:
        assert trial.step_s == pytest.approx(0.017)
        assert len(trial) == trial.meta.rest_samples + round(2 * 0.5 / 0.017)
        assert trial.meta.source == "rig"
        assert not np.any(np.isnan(trial.markers_m))
        np.testing.assert_allclose(trial.tip_m, trial.markers_m[:, 12:].mean(axis=1))


def test_the_link_rests_in_the_rest_rows(written):
    for trial in read_trials(written):
        rest = trial.markers_m[: trial.meta.rest_samples]
        # The noise of the markers is 0.15 mm; drift over the rest stays below a millimetre.
        assert np.max(np.abs(rest - rest.mean(axis=0))) < 1.2e-3
        assert not np.any(trial.goal_rad[: trial.meta.rest_samples + 1])
        assert np.max(np.abs(trial.angle_rad[: trial.meta.rest_samples])) < 2e-3


def test_angle_and_current_come_in_whole_counts(written):
    for trial in read_trials(written):
        pulses = trial.angle_rad / (2 * np.pi / 501_923)
        counts = trial.current_a / (33.0 / 2048)
        for values in (pulses, counts):
            np.testing.assert_allclose(values, np.round(values), atol=1e-6)


def test_markers_follow_the_link_of_the_contract(written, rigid_markers):
    """The whole link at rest, and its first quarter in motion, near the first mode."""
    for trial in read_trials(written):
        error = trial.markers_m - rigid_markers(trial.angle_rad)
        assert np.max(np.abs(error[:60])) < 0.01
        assert np.sqrt(np.mean(error[:, :4] ** 2)) < 0.025
        assert np.ptp(trial.tip_m[:, 0]) > 0.1  # it did move


def test_the_overview_is_drawn_and_conditions_stay_beside_the_trials(written):
    assert (written / "overview.svg").read_text().startswith("<?xml")
    record = json.loads((written / "rig_conditions.json").read_text())
    assert set(record["trials"]) == {t.name for t in read_trials(written)}


def test_same_seed_same_bits_whoever_computes(written, tmp_path):
    """The same trials from two processes, in another company of trials."""
    options = ["--dof", "1", "2", "--seed", "3", "--workers", "2"]
    assert main(["simulate", "--out", str(tmp_path), *QUICK, *options, "--trials", "2"]) == DONE
    for trial in read_trials(written):
        again = (tmp_path / f"{trial.name}.csv").read_bytes()
        assert again == (written / f"{trial.name}.csv").read_bytes()


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


def test_seeds_and_repetitions_differ(short, short_case, default_trial):
    for case in (short_case(seed=1), short_case(trial=2)):
        other = run_case(short, case)
        assert np.all(np.std(other.tip_m - default_trial.tip_m, axis=0) > 1e-5)


def test_a_trial_survives_its_file_to_the_bit(default_trial, tmp_path):
    again = read_trial(write_trial(default_trial, tmp_path))
    assert again.sha256() == default_trial.sha256()


def test_further_trials_join_and_same_options_renew(written, capsys):
    before = {p.name: p.read_bytes() for p in written.glob("*.csv")}
    assert run(written, "--motion", "multisine", "--seed", "3") == DONE
    assert run(written, "--dof", "1", "--seed", "3") == DONE
    after = {p.name: p.read_bytes() for p in written.glob("*.csv")}
    assert before.items() <= after.items()
    assert len(after) == len(before) + 1


@pytest.mark.parametrize("options", [["--seed", "4"], ["--seed", "3", "--hide", "creep=0.1"]])
def test_trials_of_other_conditions_are_not_overwritten(written, options, capsys):
    before = {p.name: p.read_bytes() for p in written.glob("*.csv")}
    assert run(written, *options) == BAD_INPUT
    assert "other conditions" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in written.glob("*.csv")} == before


def test_what_is_hidden_is_not_told_by_the_trial(tmp_path):
    assert run(tmp_path, "--hide", "backlash=0.01") == DONE
    for path in tmp_path.glob("dof*"):
        assert "backlash" not in path.read_text()
    assert '"backlash": 0.01' in (tmp_path / "rig_conditions.json").read_text()


@pytest.mark.parametrize(
    "options, named",
    [
        (["--hide", "slop=1"], "choose from coulomb_friction"),
        (["--hide", "backlash=lots"], "is not a number"),
        (["--hide", "backlash=nan"], "finite"),
        (["--hide", "backlash=5"], "outside 0 to 0.1"),
        (["--hide", "creep=0.1", "--hide", "creep=0.2"], "twice"),
        (["--payloads", "-1"], "--payloads -1"),
        (["--payloads", "50"], "choose 0 to 10"),
        (["--payloads", "nan"], "--payloads nan"),
        (["--trials", "0"], "--trials 0"),
        (["--seed", "-1"], "--seed -1"),
        (["--amplitude-deg", "120"], "choose 0 to 90"),
        (["--period", "0"], "period: is 0 s"),
        (["--phase-deg", "1000"], "--phase-deg 1000"),
        (["--pressure-pa", "0"], "--pressure-pa 0"),
        (["--gravity", "0", "0", "0"], "direction"),
        (["--workers", "0"], "--workers 0"),
        (["--rig", "missing.toml"], "missing.toml"),
        (["--payloads", "10", "--amplitude-deg", "60", "--period", "4"], "the link folds"),
    ],
)
def test_wrong_options_get_one_sentence(options, named, tmp_path, capsys):
    assert run(tmp_path / "out", *options) == BAD_INPUT
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert named in error[0]
    assert not list((tmp_path / "out").glob("*.csv"))


def test_a_folding_link_is_reported_across_processes(tmp_path, capsys):
    options = ["--payloads", "9", "10", "--amplitude-deg", "60", "--trials", "1", "--workers", "2"]
    assert main(["simulate", "--out", str(tmp_path), *options]) == BAD_INPUT
    assert "the link folds" in capsys.readouterr().err
