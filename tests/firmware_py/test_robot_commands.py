"""Commands of the robot, against servos in memory behind a socket."""

import json
import shutil
import socket

import msgspec
import numpy as np
import pytest

from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.config import read_config
from firmware_py.core.documents import read_document, write_document
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.estimator import LaggedEstimator
from firmware_py.inference.manifest import write_manifest
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.log.recording import read_recording
from firmware_py.summary import RunDocument
from models.plant.plant import read_plant
from models.trials.files import read_trial
from tests.firmware_py.conftest import CONFIG
from tests.firmware_py.goals.small_plan import OTHER_PLANT, small_plan


@pytest.mark.slow
def test_a_run_is_logged_replayed_and_imported_as_a_trial(
    tmp_path, servos, config, toy_bundle, call
):
    code, output = call("run", "--config", config, "--json")
    assert code == 0, output.err
    result = json.loads(output.out)
    assert result["ended"] == "finished"
    log = read_recording(result["log"])
    assert len(log.columns["tick"]) == result["logged_ticks"]
    assert log.metadata["slots"] == str(len(read_config(config).goals_rad()))
    assert servos.get(1, Register.TORQUE_ENABLE) == 0
    summary = read_document((tmp_path / result["log"]).with_suffix(".timing.json"), RunDocument)
    assert json.loads(msgspec.json.encode(summary)) == result

    code, output = call("replay", result["log"], "--json")
    assert (code, json.loads(output.out)["agree"]) == (0, True)
    assert json.loads(output.out)["bundle"] == str(toy_bundle)

    mapping = tmp_path / "map.toml"
    mapping.write_text(
        "[trial]\npayload_kg = 1.0\npressure_pa = 41300.0\ntrial = 1\nbase_offset_m = 0.06\n"
        "link_length_m = 0.95\nlink_width_m = 0.15\n"
    )
    out = tmp_path / "trials"
    arguments = ["import", result["log"], "--as", "recording", "--map", mapping, "--out", out]
    code, output = call(*arguments, "--name", "run")
    assert code == 0, output.err
    trial = read_trial(out / "run.csv")
    at_once = log.columns["bus_status"] == BusStatus.OK
    if at_once.all() and not log.columns["missed"].any() and not result["telemetry_drops"]:
        assert np.array_equal(trial.angle_rad[:, 0], log.columns["angle_1_rad"])
        assert np.array_equal(trial.goal_rad[:, 0], log.columns["goal_1_rad"])
    meta = trial.meta
    assert (meta.motion, meta.period_s, meta.source) == ("sinusoid", 0.4, "recording")
    assert trial.step_s == pytest.approx(0.017)
    assert np.isnan(trial.tip_m).all()
    assert np.isfinite(trial.columns["predicted_tip_z_m"]).all()


@pytest.mark.slow
def test_a_replay_through_another_bundle_disagrees(
    tmp_path, servos, config, toy_bundle, call, monkeypatch
):
    _, output = call("run", "--config", config, "--json")
    log = json.loads(output.out)["log"]
    update = LaggedEstimator.update

    def shifted(self, angle_rad, current_a, step_s):
        estimate = update(self, angle_rad, current_a, step_s)
        return estimate._replace(di=estimate.di + 1e-6)

    monkeypatch.setattr("firmware_py.inference.bundle.verify", lambda *_: None)
    monkeypatch.setattr(LaggedEstimator, "update", shifted)
    code, output = call("replay", log, "--json")
    result = json.loads(output.out)
    assert (code, result["agree"]) == (1, False)
    assert result["largest_difference"]["di"] == pytest.approx(1e-6)


def test_gains_that_nothing_is_compared_with_are_reported_and_logged(servos, config, call):
    servos.put(1, Register.POSITION_P_GAIN, 32)
    code, output = call("run", "--config", config, "--json")
    assert code == 0, output.err
    assert "gains = { position_p = 32, velocity_p = 0, velocity_i = 0 }" in output.err
    assert "is not signed, and it holds code that runs here" in output.err
    log = read_recording(json.loads(output.out)["log"])
    (settings,) = json.loads(log.metadata["servo_settings"])
    assert settings["Position P Gain"] == 32


def test_a_bundle_for_another_servo_is_named(servos, config, toy_bundle, call):
    bundle = shutil.copytree(toy_bundle, config.with_name("bundle"))
    link = config.with_name("link.toml")
    assert call("new", link, "--servo", "XM430-W350")[0] == 0
    manifest = read_manifest(bundle)
    read_plant(link).write(bundle / "plant.json")
    write_manifest(bundle, manifest)
    text = config.read_text().replace(str(toy_bundle), str(bundle))
    config.write_text(text, encoding="utf-8")
    error = call("run", "--config", config)[1].err
    assert "servo 1 is a H54-200-S500-R with 3.8 times the torque per ampere" in error


@pytest.mark.parametrize("terminal", ["open", "gone"])
def test_a_trip_is_reported_and_is_a_negative_verdict(servos, config, call, monkeypatch, terminal):
    def gone(*_):
        raise OSError(5, "Input/output error")

    if terminal == "gone":
        monkeypatch.setattr("firmware_py.commands.run.emit", gone)
    config.write_text(
        config.read_text().replace("hold_s = 0.05", "hold_s = 0.05\ntip_max_m = [1.2, 1.2, 0.1]")
    )
    code, output = call("run", "--config", config)
    assert code == 1
    assert ("tripped" in output.out) is (terminal == "open")
    assert "the predicted tip has z" in output.err
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("id = 1", "id = 2"), "servo 2 gives no valid answer"),
        (("H54-200-S500-R", "H42-20-S300-R"), "servo 1 is H54-200-S500-R, not H42-20-S300-R"),
        (("unix:", "unix:/no"), "cannot be connected to"),
        (("amplitude_rad = 0.02", "amplitude_rad = 0.5"), "motion sinusoid"),
        (("[motion]", "[[servos]]\nid = 2\nmodel = 'H54-200-S500-R'\n[motion]"), "is for 1 joints"),
        (('bundle = "', 'bundle = "/no'), "is missing"),
        (("[bus]", "period_s = 0.02\n[bus]"), "lagged estimator"),
        (("[motion]", f"[trust]\nkeys = ['ed25519:{43 * 'A'}=']\n[motion]"), "is not signed, and"),
    ],
)
def test_a_set_up_that_cannot_run_gets_one_sentence(servos, config, call, change, words):
    config.write_text(config.read_text().replace(*change, 1))
    code, output = call("run", "--config", config)
    assert code == 2
    assert words in output.err
    assert len(output.err.splitlines()) == 1
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_plan_is_run_instead_of_the_motion(tmp_path, servos, config, toy_bundle, call):
    other = {"plant_sha256": "0" * 64, "link": STUDY_FACTS}
    write_document(tmp_path / "plan.json", msgspec.structs.replace(small_plan(toy_bundle), **other))
    plan = ["--plan", tmp_path / "plan.json"]
    code, output = call("run", "--config", config, *plan)
    assert (code, "needs the payload" in output.err) == (2, True)
    code, output = call("run", "--config", config, *plan, "--motion", "steps")
    assert (code, "is given beside a motion" in output.err) == (2, True)
    code, output = call("run", "--config", config, "--open-loop")
    assert (code, "is given without --plan" in output.err) == (2, True)
    code, output = call("run", "--config", config, *plan, "--payload-kg", "0.5", "--json")
    assert code == 0, output.err
    log = read_recording(json.loads(output.out)["log"])
    assert json.loads(log.metadata["motion"])["motion"] == "plan_circle"
    assert OTHER_PLANT in log.metadata["goals_note"]
    assert output.err.count(log.metadata["goals_note"]) == 1
    goal_rad = log.columns["goal_1_rad"]
    assert 0.0 < goal_rad.max() < 0.0225
    if not log.columns["missed"].any() and not log.columns["stale_ticks"].any():
        assert goal_rad.max() == pytest.approx(0.022, abs=1e-3)


@pytest.mark.parametrize("name", ["run.mcap", "run.timing.json"])
def test_a_log_or_a_summary_that_exists_is_not_overwritten(config, tmp_path, call, name):
    (tmp_path / name).write_text("precious")
    code, output = call("run", "--config", config, "--log", tmp_path / "run.mcap")
    assert (code, f"{name} exists" in output.err) == (2, True)
    assert (tmp_path / name).read_text() == "precious"


def test_without_a_log_a_doubtful_payload_is_reported(servos, config, call, monkeypatch):
    def doubt(*_):
        return f"torque {servos.get(1, Register.TORQUE_ENABLE)}"

    monkeypatch.setattr("firmware_py.commands.run.contradicted_payload", doubt)
    config.write_text("record = false\n" + config.read_text())
    code, output = call("run", "--config", config, "--json")
    assert (code, json.loads(output.out)["log"]) == (0, None)
    assert "warning: torque 0\n" in output.err and '"payload_note": "torque 0"' in output.out
    assert not list(config.parent.rglob("*.mcap"))


def test_the_golden_ticks_of_a_bundle_are_replayed(toy_bundle, tmp_path, call):
    code, output = call("replay", "--bundle", toy_bundle)
    assert (code, "golden ticks agree" in output.out) == (0, True)
    broken = shutil.copytree(toy_bundle, tmp_path / "bundle")
    (broken / "golden.npz").unlink()
    code, output = call("replay", "--bundle", broken)
    assert (code, "golden.npz" in output.err) == (2, True)


@pytest.mark.parametrize(
    ("baud", "code", "words"),
    [(1_000_000, 0, ""), (115_200, 0, "no time to"), (57_600, 2, "57,600 baud need 10.4 ms")],
)
def test_doctor_checks_the_time_of_the_bus(tmp_path, call, baud, code, words):
    path = tmp_path / "robot.toml"
    text = CONFIG.format(bundle="none", port="none").replace("[bus]", f"[bus]\nbaud = {baud}")
    path.write_text(text.replace("reply_timeout_s = 0.017", "reply_timeout_s = 0.008"))
    exit_code, output = call("doctor", "--bus", "--config", path)
    assert exit_code == code
    assert words in output.out + output.err and (words or "no time to" not in output.out)
    if code:
        assert call("run", "--config", path)[0] == code
    code, output = call("doctor", "--json")
    report = json.loads(output.out)
    assert report["good"] is not any(f["verdict"] == "spoils" for f in report["findings"])
    assert code == (0 if report["good"] else 1)


@pytest.mark.parametrize(
    "words",
    [
        ["--bus"], ["--config", "robot.toml"], ["--check-joints"],
        ["--check-joints", "--bus", "--config", "robot.toml"],
    ],
)  # fmt: skip
def test_doctor_names_the_options_that_belong_together(words, call):
    code, output = call("doctor", *words)
    assert (code, words[0] in output.err) == (2, True)


@pytest.mark.slow
def test_a_run_notifies_systemd_when_it_is_ready_and_when_it_stops(
    servos, config, call, monkeypatch, tmp_path
):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "2000000")
        code, output = call("run", "--config", config)
        assert code == 0, output.err
        messages = [systemd.recv(100)]
        while messages[-1] != b"STOPPING=1":
            messages.append(systemd.recv(100))
    assert (messages[0], set(messages[1:-1])) == (b"READY=1", {b"WATCHDOG=1"})


def test_a_servo_that_is_still_driven_is_released(servos, config, call):
    servos.put(1, Register.TORQUE_ENABLE, 1)
    code, output = call("release", "--config", config)
    assert (code, output.out) == (0, "torque off\n")
    assert servos.get(1, Register.TORQUE_ENABLE) == 0
    code, output = call("release", "--config", config)  # nobody answers a second time
    assert (code, "switch its power off" in output.out) == (1, True)


def test_torque_goes_off_despite_a_mistake_elsewhere_in_the_file(servos, config, call):
    servos.put(1, Register.TORQUE_ENABLE, 1)
    wrong = config.read_text() + f"rate_rad_s = 1{'0' * 400}\n[limits.unknown]\n"
    config.write_text(wrong.replace("hold_s = 0.05", "hold_s = 'long'"))
    assert call("run", "--config", config)[0] == 2
    assert call("release", "--config", config)[0] == 0
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


@pytest.mark.parametrize(
    "mistake", [b"no TOML\n", b"[limits\n", b"# caf\xe9\n", b"x = 1" + 5000 * b"0" + b"\n"]
)
def test_torque_goes_off_despite_a_file_that_is_no_toml(servos, config, call, mistake):
    servos.put(1, Register.TORQUE_ENABLE, 1)
    config.write_bytes(mistake + config.read_bytes() + b"[link]\n" + mistake)
    assert call("run", "--config", config)[0] == 2
    code, output = call("release", "--config", config)
    assert code == 0
    assert "Only [bus] and [[servos]] are read" in output.err and output.err.count("\n") == 1
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_mistake_in_the_bus_itself_is_refused_by_release(config, call):
    config.write_text(config.read_text().replace("[bus]", "[bus]\nno TOML"))
    code, output = call("release", "--config", config)
    assert (code, "is not TOML" in output.err, output.err.count("\n")) == (2, True, 1)
