"""Notification of systemd, and the installed service: who writes into it, what it reaches."""

import configparser
import json
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from dropstitch.__main__ import main
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.commands.install_service import RULE_PATH, SERVICE_PATH, service_file
from firmware_py.config import read_config
from firmware_py.core.errors import InputError
from firmware_py.system.clock import RealTimeOptions, SimClock
from firmware_py.system.service import SystemdService
from tests.firmware_py.test_loop import Bus, make

CONFIG = """
bundle = "bundle"
[bus]
port = "/dev/ttyUSB0"
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


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


EXPOSURE = 4.0
"""Largest exposure by 'systemd-analyze security'; without hardening it is 9.6."""


def install(config, root, *arguments):
    return main(["install-service", "--config", str(config), "--root", str(root), *arguments])


@pytest.mark.parametrize(
    "user",
    ["robot\nExecStart=/bin/sh", "robot\r", "", "-robot", "a b", "%u", "$USER", "ro;bot", "é", "0"],
)
def test_a_user_that_is_no_user_name_is_refused(tmp_path, config, user, capsys):
    assert install(config, tmp_path / "root", f"--user={user}") == 2
    assert "is no user name" in capsys.readouterr().err
    assert not (tmp_path / "root").exists()


def test_a_user_who_does_not_exist_is_refused_before_anything_is_written(
    config, monkeypatch, capsys
):
    monkeypatch.setattr("os.geteuid", lambda: 0)
    monkeypatch.setattr("firmware_py.commands.install_service._write", pytest.fail)
    assert install(config, "/", "--user", "nobody-of-this-name") == 2
    assert "does not exist" in capsys.readouterr().err


@pytest.mark.parametrize("mark", ["\n", "\r", "\x1b", "\u2028", "\udcff"])
def test_a_path_with_a_line_break_is_refused(tmp_path, config, mark, capsys):
    directory = tmp_path / f"a{mark}ExecStartPre=b"
    directory.mkdir()
    config = config.rename(directory / "robot.toml")
    assert install(config, tmp_path / "root") == 2
    assert "control character" in capsys.readouterr().err
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize("key", ["logs", "port"])
def test_a_directory_of_the_configuration_writes_no_directive(config, key):
    value = "x\\nUser=root/line"
    text = config.read_text()
    if key == "logs":
        config.write_text(f'logs = "{value}"\n{text}')
    else:
        config.write_text(text.replace("/dev/ttyUSB0", f"unix:{value}"))
    with pytest.raises(InputError, match="control character"):
        service_file(read_config(config), config, "robot")


@pytest.mark.parametrize("dangling", [True, False])
def test_a_symbolic_link_in_place_of_the_unit_is_not_followed(tmp_path, config, dangling, capsys):
    other, unit = tmp_path / "other", tmp_path / "root" / SERVICE_PATH
    unit.parent.mkdir(parents=True)
    if not dangling:
        other.write_text("precious")
    unit.symlink_to(other)
    assert install(config, tmp_path / "root") == 2
    assert "is a symbolic link to" in capsys.readouterr().err
    assert other.exists() is not dangling
    assert dangling or other.read_text() == "precious"


def test_a_link_that_appears_while_the_unit_is_written_is_replaced(tmp_path, config, monkeypatch):
    other, unit = tmp_path / "other", tmp_path / "root" / SERVICE_PATH
    other.write_text("precious")
    replace = Path.replace

    def link_first(self, target):
        if target == unit:
            unit.symlink_to(other)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", link_first)
    assert install(config, tmp_path / "root") == 0
    assert (other.read_text(), unit.is_symlink()) == ("precious", False)


def directives(config):
    """Hardening of the unit, without what a transient service has otherwise."""
    text = service_file(read_config(config), config, "root")
    lines = text[text.index("AmbientCapabilities=") :].splitlines()
    return [line for line in lines if line and line[0] != "#"]


def test_the_service_reaches_the_port_its_logs_and_no_network(config):
    found = directives(config)
    assert {"ProtectSystem=strict", "PrivateTmp=yes", "NoNewPrivileges=yes"} <= set(found)
    assert "DevicePolicy=closed" in found
    assert "DeviceAllow=char-ttyUSB rw" in found
    assert "RestrictAddressFamilies=AF_UNIX" in found
    assert f"ReadWritePaths=-{config.parent}/logs" in found
    assert "CapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK" in found
    assert not any(
        line.startswith(("PrivateDevices=yes", "RestrictRealtime=yes")) for line in found
    )


def test_the_socket_of_an_emulator_is_not_hidden_by_the_private_tmp(config):
    config.write_text(CONFIG.replace("/dev/ttyUSB0", "unix:/tmp/my line/socket"))
    assert '\nBindReadOnlyPaths="-/tmp/my line"\n' in service_file(
        read_config(config), config, "robot"
    )


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_the_exposure_of_the_service_is_low(tmp_path, config):
    assert install(config, tmp_path / "root", "--user", "robot") == 0
    command = ["systemd-analyze", "security", "--offline=yes", "--no-pager"]
    result = subprocess.run(
        [*command, tmp_path / "root" / SERVICE_PATH], capture_output=True, text=True
    )
    if "unrecognized option" in result.stderr:
        pytest.skip("needs systemd 250")
    exposure = re.search(r"Overall exposure level for \S+: ([0-9.]+)", result.stdout)
    assert exposure, result.stderr
    assert float(exposure[1]) <= EXPOSURE


REAL_TIME = """
import os
from firmware_py.system.clock import RealTimeOptions, real_time
with real_time(RealTimeOptions(priority=50)) as refused:
    assert not refused, refused
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    locked = next(l for l in open("/proc/self/status") if l.startswith("VmLck"))
    assert int(locked.split()[1]) > 10_000, locked
"""


@pytest.mark.skipif(
    os.geteuid() != 0 or not Path("/run/systemd/system").exists(), reason="needs systemd and root"
)
def test_the_hardened_service_is_still_real_time(config):
    properties = [word for line in directives(config) for word in ("-p", line)]
    root = str(Path(__file__).parents[3])
    result = subprocess.run(
        ["systemd-run", "--wait", "--pipe", "--quiet", "-p", "User=nobody", *properties,
         "-E", f"PYTHONPATH={root}", sys.executable, "-c", REAL_TIME],
        capture_output=True, text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr


def bounded_by(lines):
    """Command that takes the rights of a service without systemd, as user 65534; None without."""
    given = dict(line.split("=", 1) for line in lines)
    assert given["NoNewPrivileges"] == "yes"
    assert given["AmbientCapabilities"] == given["CapabilityBoundingSet"]
    names = [name.removeprefix("CAP_").lower() for name in given["AmbientCapabilities"].split()]
    rights = ",".join(["-all", *(f"+{name}" for name in names)])
    sets = [f"--{name}={rights}" for name in ("bounding-set", "inh-caps", "ambient-caps")]
    return ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "--no-new-privs", *sets]


@pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv"
)
def test_the_rights_of_the_service_are_enough_for_real_time(config):
    """Also where systemd does not run: the same capabilities, a plain user, no new privileges."""
    lines = [line for line in directives(config) if not line.startswith("DeviceAllow")]
    command = bounded_by(lines)
    if subprocess.run([*command, "true"], capture_output=True).returncode:
        pytest.skip("this machine does not grant the capabilities")
    python = [sys.executable, "-c", REAL_TIME]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}
    result = subprocess.run([*command, *python], capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    none = [word.partition("=")[0] + "=-all" if "-all" in word else word for word in command]
    refused = subprocess.run([*none, *python], capture_output=True, text=True, env=environment)
    assert "SCHED_FIFO is refused" in refused.stderr
