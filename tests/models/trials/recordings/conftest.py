"""One known run of a rigid link, recorded by a servo and by motion capture on two clocks."""

from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from models.trials.files import read_trial

SERVO_AHEAD_S = 1.2345  # what the servo's clock shows less than the mocap's at the same moment
CONDITIONS = {
    "payload_kg": 1.0, "pressure_pa": 41.3e3, "trial": 1, "motion": "sinusoid", "period_s": 2.0,
    "amplitude_rad": 0.5, "base_offset_m": 0.06, "link_length_m": 0.95, "link_width_m": 0.15,
}  # fmt: skip


def angle_rad(time_s):
    """Angles at true times: rest, two swings of 2 s that begin and end smoothly, rest."""
    t = np.clip(time_s - 0.5, 0, 4.0)
    first = -0.5 * np.sin(np.pi * t) * np.sin(0.25 * np.pi * t) ** 2
    return np.column_stack([first, 0.3 * np.sin(np.pi * t) ** 2 * np.sin(0.5 * np.pi * t)])


@pytest.fixture
def session(rigid_markers):
    """True signals on two clocks: mocap at 240 Hz, servo at 100 Hz with uneven steps."""
    mocap_s = np.arange(0, 5.3, 1 / 240)
    servo_s = np.arange(0.2, 5.2, 0.01) + 0.002 * np.random.default_rng(7).random(500)
    return SimpleNamespace(
        mocap_s=mocap_s,
        markers_m=rigid_markers(angle_rad(mocap_s)),
        servo_true_s=servo_s,
        first_s=servo_s[0],
        servo_s=servo_s - SERVO_AHEAD_S,
        angle_rad=angle_rad(servo_s),
        current_a=3 * angle_rad(servo_s),
        offset_s=SERVO_AHEAD_S,
    )


@pytest.fixture
def check(rigid_markers):
    """Compare an imported trial with the truth; returns the trial."""

    def compare(path, first_true_s, atol_m=3e-4):  # at 1.6 m/s, 0.2 ms
        trial = read_trial(path)
        truth = angle_rad(first_true_s + trial.time_s)
        assert trial.angle_rad == pytest.approx(truth, abs=2e-4)  # linear between 10 ms samples
        assert trial.current_a == pytest.approx(3 * truth, abs=6e-4)
        markers_m = rigid_markers(truth)
        visible = np.isfinite(trial.markers_m)
        assert visible.mean() > 0.9
        assert trial.markers_m[visible] == pytest.approx(markers_m[visible], abs=atol_m)
        assert trial.tip_m == pytest.approx(markers_m[:, 12:].mean(axis=1), abs=atol_m)
        return trial

    return compare


@pytest.fixture
def write_map(tmp_path):
    """Write MAP.toml; the conditions of a trial with two joints are filled in."""

    def write(**tables):
        path = tmp_path / "map.toml"
        trial = {"dof": 2} | CONDITIONS | tables.pop("trial", {})
        trial = {k: v for k, v in trial.items() if v is not None}
        path.write_text(tomli_w.dumps({"trial": trial} | tables))
        return path

    return write


@pytest.fixture
def servo_csv(session, tmp_path):
    """The servo's log as a table in degrees and milliamperes; returns path and [columns]."""
    path = tmp_path / "servo.csv"
    header, columns = ["ms"], {"time_s": {"from": "ms", "unit": "ms"}}
    values = [session.servo_s * 1e3]
    for j in (1, 2):
        header += [f"pos{j}", f"cur{j}", f"status{j}"]
        values += [np.degrees(session.angle_rad[:, j - 1]), session.current_a[:, j - 1] * 1e3]
        values.append(np.full(500, np.nan))  # becomes a column of words that nobody mapped
        columns |= {
            f"angle_{j}_rad": {"from": f"pos{j}", "unit": "deg"},
            f"goal_{j}_rad": {"from": f"pos{j}", "unit": "deg"},
            f"current_{j}_a": {"from": f"cur{j}", "unit": "mA"},
        }
    rows = [",".join(f"{v:.9g}" for v in row) for row in np.column_stack(values)]
    text = "\n".join([",".join(header), *rows]) + "\n"
    path.write_text(text.replace("nan", "OK"))
    return path, columns


@pytest.fixture
def run(tmp_path, capsys):
    """Run the command; returns exit code, standard output and standard error."""
    from dropstitch.__main__ import main

    def call(*arguments):
        code = main(["import", *map(str, arguments), "--out", str(tmp_path / "trials")])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def refused(run):
    """Run the command, expect one sentence and exit 2."""

    def call(*arguments):
        code, _, err = run(*arguments)
        assert code == 2
        assert err.startswith("dropstitch: ") and err.count("\n") == 1
        assert "Traceback" not in err
        return err

    return call
