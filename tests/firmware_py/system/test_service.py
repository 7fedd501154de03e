"""Notification of systemd, and the service file and udev rule that are installed."""

import configparser
import json
import re
import shutil
import socket
import subprocess
import sys

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.commands.install_service import RULE_PATH, SERVICE_PATH, service_file
from firmware_py.config import read_config
from firmware_py.system.clock import RealTimeOptions, SimClock
from firmware_py.system.service import SystemdService
from tests.firmware_py.test_loop import Bus, make

CONFIG = """
bundle = "bundle"
[bus]
port = "unix:line"
[[servos]]
id = 1
model = "H54-200-S500-R"
"""
SECOND_NS = 1_000_000_000


@pytest.fixture(params=["path", "abstract"])
def systemd(request, tmp_path):
    """A socket as systemd gives it, and the environment that names it."""
    address = str(tmp_path / "notify") if request.param == "path" else f"@{tmp_path}/notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(address.replace("@", "\0"))
        end.setblocking(False)
        yield end, {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000"}


def heard(end):
    """Everything that has arrived."""
    messages = []
    try:
        while True:
            messages.append(end.recv(1024).decode())
    except BlockingIOError:
        return messages


def test_the_loop_is_ready_then_alive_four_times_a_timeout_then_stopping(systemd):
    end, environment = systemd
    clock = SimClock(SECOND_NS)
    service = SystemdService(clock, environment)
    assert heard(end) == []
    service.alive()
    assert heard(end) == ["READY=1"]
    for _ in range(100):
        clock.advance(17_000_000)
        service.alive()
    assert heard(end) == ["WATCHDOG=1"] * 3, "every half second of 1.7"
    service.close()
    assert heard(end) == ["STOPPING=1"]
    service.alive()
    service.close()
    assert heard(end) == []


def test_without_a_watchdog_systemd_hears_only_start_and_end(systemd):
    end, environment = systemd
    clock = SimClock()
    service = SystemdService(clock, {"NOTIFY_SOCKET": environment["NOTIFY_SOCKET"]})
    for _ in range(1000):
        service.alive()
        clock.advance(SECOND_NS)
    service.close()
    assert heard(end) == ["READY=1", "STOPPING=1"]


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "vsock:2:1234"}])
def test_where_nobody_asks_nothing_is_said(environment, monkeypatch):
    opened = []
    monkeypatch.setattr(socket, "socket", lambda *of: opened.append(of))
    service = SystemdService(SimClock(), environment)
    service.alive()
    service.close()
    assert not opened


def test_a_systemd_that_does_not_listen_holds_nobody_up(systemd):
    end, environment = systemd
    clock = SimClock()
    service = SystemdService(clock, environment)
    for _ in range(10_000):  # far beyond what the socket queues
        clock.advance(SECOND_NS)
        service.alive()
    assert 0 < len(heard(end)) < 10_000
    end.close()
    clock.advance(SECOND_NS)
    service.alive()


class Listener:
    signs = 0

    def alive(self):
        self.signs += 1


def test_the_loop_is_alive_while_it_waits_for_a_port():
    class Unplugged(Bus):
        def reopen(self):
            return False

    service = Listener()
    loop, bus, *_ = make(bus=Unplugged, service=service, replug_s=10.0)
    bus.script = dict.fromkeys(range(50, 500), BusStatus.PORT_GONE)
    summary = loop.run()
    assert service.signs - summary.ticks == 200, "every 50 ms of 10 s"


# The unit and the rule ------------------------------------------------------------------------


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


def parsed(text):
    lines = [line for line in text.splitlines() if not line.startswith("DeviceAllow=")]
    parser = configparser.ConfigParser(delimiters="=", interpolation=None, strict=True)
    parser.optionxform = str
    parser.read_string("\n".join(lines))  # systemd wants a line for every device
    return parser


def test_the_unit_gives_the_loop_what_it_needs_and_no_more(config):
    parser = parsed(service_file(read_config(config), config, "robot"))
    assert parser.sections() == ["Unit", "Service"], "no [Install]: nothing starts it by itself"
    service = parser["Service"]
    assert (service["Type"], service["Restart"], service["User"]) == ("notify", "no", "robot")
    assert service["ExecStart"] == f"{sys.executable} -m dropstitch run --config {config}"
    assert service["ExecStopPost"] == f"{sys.executable} -m dropstitch release --config {config}"
    assert set(service["AmbientCapabilities"].split()) == {"CAP_SYS_NICE", "CAP_IPC_LOCK"}
    assert (service["LimitMEMLOCK"], service["LimitRTPRIO"]) == ("infinity", "99")
    assert float(service["WatchdogSec"]) > 1
    assert not [key for key in service if key.startswith("CPUScheduling")], "of every thread"


@pytest.mark.parametrize(
    ("own", "processors", "expected"),
    [(None, {0, 1}, "0 1"), (1, {0, 1}, "0"), (0, {0, 1, 2, 3}, "1 2 3"), (0, {0}, "0"),
     (7, {0, 1}, "0 1")],
)  # fmt: skip
def test_a_processor_of_the_loops_own_is_kept_free(config, own, processors, expected):
    options = RealTimeOptions(cpu=own)
    configured = msgspec.structs.replace(read_config(config), real_time=options)
    text = service_file(configured, config, "robot", frozenset(processors))
    assert parsed(text)["Service"]["CPUAffinity"] == expected


@pytest.mark.parametrize("name", ["robot.toml", "my robot 100%.toml", 'a "b" $HOME.toml'])
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit(tmp_path, config, capsys, name):
    config = config.rename(tmp_path / name)
    root = tmp_path / "root"
    assert main(["install-service", "--config", str(config), "--root", str(root)]) == 0
    assert complaints(root / SERVICE_PATH) == ""
    text = (root / SERVICE_PATH).read_text()
    (root / SERVICE_PATH).write_text(text.replace("WatchdogSec=2", "WatchdogSec=soon"))
    assert "ignoring: soon" in complaints(root / SERVICE_PATH), (
        "it does complain where it has reason to"
    )


def complaints(path):
    """What systemd says about a unit."""
    verdict = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True)
    said = [line for line in verdict.stderr.splitlines() if "dropstitch" in line]
    return "\n".join(said) if said or verdict.returncode == 0 else verdict.stderr


def test_the_rule_sets_the_latency_timer_of_ftdi_adapters(tmp_path, config, capsys):
    assert main(["install-service", "--config", str(config), "--dry-run", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    (rule,) = [line for line in files[RULE_PATH].splitlines() if not line.startswith("#")]
    parts = dict(re.fullmatch(r"(\S+?)(==|=)(\".*\")", p).group(1, 2) for p in rule.split(", "))
    assert parts == {"ACTION": "==", "SUBSYSTEM": "==", "DRIVER": "==", "ATTR{latency_timer}": "="}
    assert 'ATTR{latency_timer}="1"' in rule


def test_nothing_is_written_without_root(config, monkeypatch, capsys):
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert main(["install-service", "--config", str(config)]) == 2
    error = capsys.readouterr().err
    assert "needs root" in error and error.count("\n") == 1
    assert main(["install-service", "--config", str(config), "--dry-run"]) == 0
