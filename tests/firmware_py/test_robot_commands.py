"""Commands of the robot, against servos in memory behind a socket."""

import contextlib
import json
import shutil
import socket
import threading

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.port import RegisterAccess
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.config import read_config
from firmware_py.core.documents import read_document
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.manifest import write_manifest
from firmware_py.log.recording import read_recording
from firmware_py.summary import RunDocument
from models.plant.plant import read_plant

CONFIG = """
bundle = "{bundle}"
[bus]
port = "unix:{port}"
reply_timeout_s = 0.017
[[servos]]
id = 1
model = "H54-200-S500-R"
[motion]
amplitude_rad = 0.02
period_s = 0.4
rest_s = 0.2
[limits]
hold_s = 0.05
stale_ticks = 100 # the servos share a busy machine with the tests
missed_slots = 1000
[real_time]
priority = 0
lock_memory = false
"""


@pytest.fixture
def servos(tmp_path):
    """A servo in memory behind `tmp_path/line`."""
    transport = LoopbackTransport({1: MODELS[54024]})
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "line"))
    listener.listen()

    def serve():
        with contextlib.suppress(OSError), listener.accept()[0] as connection:
            while data := connection.recv(4096):
                transport.write(data)
                if answer := transport.read(4096, 0):
                    connection.sendall(answer)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield transport
    listener.shutdown(socket.SHUT_RDWR)  # a test that never connected
    thread.join()
    listener.close()


@pytest.fixture
def config(tmp_path, toy_bundle):
    path = tmp_path / "robot.toml"
    path.write_text(CONFIG.format(bundle=toy_bundle, port=tmp_path / "line"), encoding="utf-8")
    return path


def call(capsys, *arguments):
    code = main([str(a) for a in arguments])
    return code, capsys.readouterr()


@pytest.mark.slow
def test_a_run_is_logged_replayed_and_imported_as_a_trial(
    tmp_path, servos, config, toy_bundle, capsys
):
    code, output = call(capsys, "run", "--config", config, "--json")
    assert code == 0, output.err
    result = json.loads(output.out)
    assert result["ended"] == "finished"
    log = read_recording(result["log"])
    assert len(log.columns["tick"]) == result["logged_ticks"]
    assert log.metadata["slots"] == str(len(read_config(config).goals_rad()))
    assert servos.get(1, Register.TORQUE_ENABLE) == 0
    summary = read_document((tmp_path / result["log"]).with_suffix(".timing.json"), RunDocument)
    assert json.loads(msgspec.json.encode(summary)) == result

    code, output = call(capsys, "replay", result["log"], "--json")
    assert (code, json.loads(output.out)["agree"]) == (0, True)
    assert json.loads(output.out)["bundle"] == str(toy_bundle)

    from dropstitch.__main__ import main as dropstitch
    from models.trials.files import read_trial

    mapping = tmp_path / "map.toml"
    mapping.write_text(
        "[trial]\npayload_kg = 1.0\npressure_pa = 41300.0\ntrial = 1\nbase_offset_m = 0.06\n"
        "link_length_m = 0.95\nlink_width_m = 0.15\n"
    )
    out = tmp_path / "trials"
    arguments = ["import", result["log"], "--as", "recording", "--map", mapping, "--out", out]
    assert dropstitch([*map(str, arguments), "--name", "run"]) == 0, capsys.readouterr().err
    trial = read_trial(out / "run.csv")
    at_once = log.columns["bus_status"] == BusStatus.OK
    if at_once.all() and not log.columns["missed"].any() and not result["telemetry_drops"]:
        assert np.array_equal(trial.angle_rad[:, 0], log.columns["angle_1_rad"])
        assert np.array_equal(trial.goal_rad[:, 0], log.columns["goal_1_rad"])
    assert (trial.meta.motion, trial.meta.period_s, trial.meta.source) == (
        "sinusoid", 0.4, "recording",
    )  # fmt: skip
    assert trial.step_s == pytest.approx(0.017)
    assert np.isnan(trial.tip_m).all()
    assert np.isfinite(trial.columns["predicted_tip_z_m"]).all()


@pytest.mark.slow
def test_a_replay_through_another_bundle_disagrees(
    tmp_path, servos, config, toy_bundle, capsys, monkeypatch
):
    _, output = call(capsys, "run", "--config", config, "--json")
    log = json.loads(output.out)["log"]
    from firmware_py.inference.estimator import LaggedEstimator

    update = LaggedEstimator.update

    def shifted(self, angle_rad, current_a, step_s):
        estimate = update(self, angle_rad, current_a, step_s)
        return estimate._replace(di=estimate.di + 1e-6)

    from firmware_py.inference import bundle

    monkeypatch.setattr(bundle, "verify", lambda *_: None)
    monkeypatch.setattr(LaggedEstimator, "update", shifted)
    code, output = call(capsys, "replay", log, "--json")
    result = json.loads(output.out)
    assert (code, result["agree"]) == (1, False)
    assert result["largest_difference"]["di"] == pytest.approx(1e-6)


def test_gains_that_are_compared_with_none_are_said_and_kept_in_the_log(servos, config, capsys):
    servos.put(1, Register.POSITION_P_GAIN, 32)
    code, output = call(capsys, "run", "--config", config, "--json")
    assert code == 0, output.err
    assert "gains = { position_p = 32, velocity_p = 0, velocity_i = 0 }" in output.err
    assert "is not signed, and it holds code that runs here" in output.err
    log = read_recording(json.loads(output.out)["log"])
    (settings,) = json.loads(log.metadata["servo_settings"])
    assert settings["Position P Gain"] == 32


def test_a_bundle_for_another_servo_is_named(servos, config, toy_bundle, capsys):
    bundle = shutil.copytree(toy_bundle, config.with_name("bundle"))
    link = config.with_name("link.toml")
    assert call(capsys, "new", link, "--servo", "XM430-W350")[0] == 0
    manifest = read_manifest(bundle)
    read_plant(link).write(bundle / "plant.json")
    write_manifest(bundle, manifest)
    text = config.read_text().replace(str(toy_bundle), str(bundle))
    config.write_text(text, encoding="utf-8")
    error = call(capsys, "run", "--config", config)[1].err
    assert "servo 1 is a H54-200-S500-R with 3.8 times the torque per ampere" in error


def test_gains_that_are_declared_are_compared(servos, config, capsys):
    servos.put(1, Register.POSITION_P_GAIN, 32)
    text = config.read_text()
    config.write_text(text.replace("[motion]", "gains = { position_p = 31 }\n[motion]", 1))
    code, output = call(capsys, "run", "--config", config)
    assert code == 2
    assert "has Position P Gain 32, the plant was identified with 31" in output.err
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_trip_is_reported_and_is_a_negative_verdict(servos, config, capsys):
    config.write_text(
        config.read_text().replace("hold_s = 0.05", "hold_s = 0.05\ntip_max_m = [1.2, 1.2, 0.1]")
    )
    code, output = call(capsys, "run", "--config", config)
    assert code == 1
    assert "tripped" in output.out
    assert "the predicted tip has z" in output.err
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_servo_that_does_not_confirm_torque_off_is_a_negative_verdict(
    servos, config, capsys, monkeypatch
):
    confirmed = RegisterAccess.put

    def unconfirmed(self, id_, cell, raw):
        done = confirmed(self, id_, cell, raw)
        return done and not (cell == MODELS[54024].table[Register.TORQUE_ENABLE] and self.releasing)

    def switched(bus, on):
        bus._registers.releasing = not on
        return torque(bus, on)

    torque = DynamixelBus.torque
    monkeypatch.setattr(RegisterAccess, "releasing", False, raising=False)
    monkeypatch.setattr(RegisterAccess, "put", unconfirmed)
    monkeypatch.setattr(DynamixelBus, "torque", switched)
    code, output = call(capsys, "run", "--config", config, "--json")
    assert code == 1
    result = json.loads(output.out)
    assert (result["ended"], result["released"]) == ("tripped", False)
    assert "stopped: the motion is over; then not every servo confirmed torque off" in output.err


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
def test_a_set_up_that_cannot_run_gets_one_sentence(servos, config, capsys, change, words):
    config.write_text(config.read_text().replace(*change, 1))
    code, output = call(capsys, "run", "--config", config)
    assert code == 2
    assert words in output.err
    assert len(output.err.splitlines()) == 1
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_plan_is_run_in_place_of_the_motion(tmp_path, servos, config, toy_bundle, capsys):
    from firmware_py.core.documents import write_document
    from firmware_py.link.link_facts import STUDY_FACTS
    from tests.firmware_py.goals.small_plan import OTHER_PLANT, small_plan

    other = {"plant_sha256": "0" * 64, "link": STUDY_FACTS}
    write_document(tmp_path / "plan.json", msgspec.structs.replace(small_plan(toy_bundle), **other))
    plan = ["--plan", tmp_path / "plan.json"]
    code, output = call(capsys, "run", "--config", config, *plan)
    assert (code, "needs the payload" in output.err) == (2, True)
    code, output = call(capsys, "run", "--config", config, *plan, "--motion", "steps")
    assert (code, "is given beside a motion" in output.err) == (2, True)
    code, output = call(capsys, "run", "--config", config, *plan, "--payload-kg", "0.5", "--json")
    assert code == 0, output.err
    log = read_recording(json.loads(output.out)["log"])
    assert json.loads(log.metadata["motion"])["motion"] == "plan_circle"
    assert f"plan.json {OTHER_PLANT} {toy_bundle}" in log.metadata["goals_note"]
    assert output.err.count(log.metadata["goals_note"]) == 1
    goal_rad = log.columns["goal_1_rad"]
    assert 0.0 < goal_rad.max() < 0.0225
    if not log.columns["missed"].any() and not log.columns["stale_ticks"].any():
        assert goal_rad.max() == pytest.approx(0.022, abs=1e-3)


def test_a_terminal_that_has_gone_hides_no_trip(servos, config, capsys, monkeypatch):
    config.write_text(
        config.read_text().replace("hold_s = 0.05", "hold_s = 0.05\ntip_max_m = [1.2, 1.2, 0.1]")
    )
    from firmware_py.commands import run

    def gone(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(run, "emit", gone)
    code, output = call(capsys, "run", "--config", config)
    assert code == 1
    assert "the predicted tip has z" in output.err


@pytest.mark.parametrize("name", ["run.mcap", "run.timing.json"])
def test_a_log_or_a_summary_that_exists_is_not_overwritten(config, tmp_path, capsys, name):
    (tmp_path / name).write_text("kept")
    code, output = call(capsys, "run", "--config", config, "--log", tmp_path / "run.mcap")
    assert (code, f"{name} exists" in output.err) == (2, True)
    assert (tmp_path / name).read_text() == "kept"


def test_without_a_log_a_doubtful_payload_is_told(servos, config, capsys, monkeypatch):
    def doubt(*_):
        return f"torque {servos.get(1, Register.TORQUE_ENABLE)}"

    monkeypatch.setattr("firmware_py.commands.run.contradicted_payload", doubt)
    config.write_text("record = false\n" + config.read_text())
    code, output = call(capsys, "run", "--config", config, "--json")
    assert (code, json.loads(output.out)["log"]) == (0, None)
    assert "warning: torque 0\n" in output.err and '"payload_note": "torque 0"' in output.out
    assert not list(config.parent.rglob("*.mcap"))


@pytest.mark.slow
def test_a_run_is_shown_live_with_or_without_a_file(servos, config, capfd):
    config.write_text("record = false\n" + config.read_text() + "[live]\nport = 0\n")
    code, output = call(capfd, "run", "--config", config, "--live", "--json")
    assert (code, json.loads(output.out)["log"]) == (0, None)
    assert "live view at ws://127.0.0.1:" in output.err
    assert not list(config.parent.rglob("*.mcap"))


def test_the_golden_ticks_of_a_bundle_are_replayed(toy_bundle, tmp_path, capsys):
    code, output = call(capsys, "replay", "--bundle", toy_bundle)
    assert (code, "golden ticks agree" in output.out) == (0, True)
    broken = shutil.copytree(toy_bundle, tmp_path / "bundle")
    (broken / "golden.npz").unlink()
    code, output = call(capsys, "replay", "--bundle", broken)
    assert (code, "golden.npz" in output.err) == (2, True)


def test_doctor_answers_for_people_and_machines(capsys):
    code, output = call(capsys, "doctor", "--json")
    report = json.loads(output.out)
    spoilt = [f for f in report["findings"] if f["verdict"] == "spoils"]
    assert (code, report["good"]) == ((1, False) if spoilt else (0, True))
    people = call(capsys, "doctor")[1].out
    assert all(finding["name"] in people for finding in report["findings"])


@pytest.mark.parametrize("arguments", [["--bus"], ["--config", "robot.toml"]])
def test_doctor_wants_the_bus_and_its_robot_together(arguments, capsys):
    code, output = call(capsys, "doctor", *arguments)
    assert (code, "--bus and --config together" in output.err) == (2, True)


def test_doctor_and_run_refuse_a_bus_that_is_too_slow(tmp_path, capsys):
    slow = tmp_path / "robot.toml"
    text = CONFIG.format(bundle="none", port="none").replace("[bus]", "[bus]\nbaud = 57600")
    slow.write_text(text.replace("reply_timeout_s = 0.017", ""))
    for command in (["doctor", "--bus"], ["run"]):
        code, output = call(capsys, *command, "--config", slow)
        assert (code, "1 servos at 57,600 baud need 10.4 ms" in output.err) == (2, True)


@pytest.mark.parametrize(("baud", "again"), [(1_000_000, True), (115_200, False)])
def test_doctor_says_where_there_is_no_time_to_read_twice(tmp_path, capsys, baud, again):
    path = tmp_path / "robot.toml"
    text = CONFIG.format(bundle="none", port="none").replace("[bus]", f"[bus]\nbaud = {baud}")
    path.write_text(text.replace("reply_timeout_s = 0.017", "reply_timeout_s = 0.008"))
    code, output = call(capsys, "doctor", "--bus", "--config", path)
    assert (code, "no time to" in output.out) == (0, not again)


def test_the_service_is_shown_before_it_is_written(config, tmp_path, capsys):
    root = tmp_path / "root"
    code, output = call(capsys, "install-service", "--config", config, "--root", root, "--dry-run")
    assert (code, root.exists()) == (0, False)
    shown = output.out
    assert call(capsys, "install-service", "--config", config, "--root", root)[0] == 0
    written = [path for path in root.rglob("*") if path.is_file()]
    assert sorted(path.name for path in written) == ["99-dropstitch.rules", "dropstitch.service"]
    assert all(path.read_text() in shown for path in written)


@pytest.mark.slow
def test_a_run_tells_systemd_when_it_is_ready_and_when_it_stops(
    servos, config, capsys, monkeypatch, tmp_path
):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "2000000")
        code, output = call(capsys, "run", "--config", config)
        assert code == 0, output.err
        heard = [systemd.recv(100)]
        while heard[-1] != b"STOPPING=1":
            heard.append(systemd.recv(100))
    assert (heard[0], set(heard[1:-1])) == (b"READY=1", {b"WATCHDOG=1"})


def test_a_servo_that_somebody_left_driven_is_released(servos, config, capsys):
    servos.put(1, Register.TORQUE_ENABLE, 1)
    code, output = call(capsys, "release", "--config", config)
    assert (code, output.out) == (0, "torque off\n")
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_mistake_elsewhere_in_the_file_does_not_keep_the_torque_on(servos, config, capsys):
    servos.put(1, Register.TORQUE_ENABLE, 1)
    wrong = config.read_text() + f"rate_rad_s = 1{'0' * 400}\n[limits.unknown]\n"
    config.write_text(wrong.replace("hold_s = 0.05", "hold_s = 'long'"))
    assert call(capsys, "run", "--config", config)[0] == 2
    assert call(capsys, "release", "--config", config)[0] == 0
    assert servos.get(1, Register.TORQUE_ENABLE) == 0


def test_a_servo_that_does_not_confirm_its_release_is_told(servos, config, capsys):
    config.write_text(config.read_text().replace("id = 1", "id = 2"))
    code, output = call(capsys, "release", "--config", config)
    assert (code, "switch its power off" in output.out) == (1, True)
