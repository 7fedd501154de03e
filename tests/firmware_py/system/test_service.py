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
from tests.firmware_py.simulated_loop import Bus, make
from tests.firmware_py.test_config import MINIMAL

SECOND_NS = 1_000_000_000


@pytest.fixture(params=["path", "abstract"])
def systemd(request, tmp_path):
    """A socket as systemd opens it, and the environment that names it."""
    address = str(tmp_path / "notify") if request.param == "path" else f"@{tmp_path}/notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(address.replace("@", "\0"))
        end.setblocking(False)
        yield end, {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000"}


def messages(end):
    """Everything that has arrived."""
    arrived = []
    try:
        while True:
            arrived.append(end.recv(1024).decode())
    except BlockingIOError:
        return arrived


def test_the_loop_is_ready_then_alive_four_times_a_timeout_then_stopping(systemd):
    end, environment = systemd
    clock = SimClock(SECOND_NS)
    service = SystemdService(clock, environment)
    assert messages(end) == []
    service.alive()
    assert messages(end) == ["READY=1"]
    for _ in range(100):
        clock.advance(17_000_000)
        service.alive()
    assert messages(end) == ["WATCHDOG=1"] * 3, "every half second of 1.7"
    service.close()
    assert messages(end) == ["STOPPING=1"]
    service.alive()
    service.close()
    assert messages(end) == []
    service = SystemdService(clock, {"NOTIFY_SOCKET": environment["NOTIFY_SOCKET"]})
    for _ in range(100):
        clock.advance(SECOND_NS)
        service.alive()
    service.close()
    assert messages(end) == ["READY=1", "STOPPING=1"], "there is no watchdog"


def test_a_systemd_that_does_not_listen_blocks_nothing(systemd):
    end, environment = systemd
    clock = SimClock()
    service = SystemdService(clock, environment)
    for _ in range(10_000):  # far beyond what the socket queues
        clock.advance(SECOND_NS)
        service.alive()
    assert 0 < len(messages(end)) < 10_000
    end.close()
    clock.advance(SECOND_NS)
    service.alive()


def test_the_loop_is_alive_while_it_waits_for_a_port():
    class Unplugged(Bus):
        def reopen(self):
            return False

    class Listener:
        signs = 0

        def alive(self):
            self.signs += 1

    service = Listener()
    loop, bus, *_ = make(bus=Unplugged, service=service, replug_s=10.0)
    bus.script = dict.fromkeys(range(50, 500), BusStatus.PORT_GONE)
    summary = loop.run()
    assert service.signs - summary.ticks == 200, "every 50 ms of 10 s"


# --- the unit and the rule ----------------------------------------------------------------------


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(MINIMAL, encoding="utf-8")
    return path


def install(config, root, *arguments):
    return main(["install-service", "--config", str(config), "--root", str(root), *arguments])


def unit(config, user="robot", *processors, **changes):
    """Text of the unit of a configuration with some changes."""
    return service_file(
        msgspec.structs.replace(read_config(config), **changes), config, user, *processors
    )


def parsed(text):
    lines = [line for line in text.splitlines() if not line.startswith("DeviceAllow=")]
    parser = configparser.ConfigParser(delimiters="=", interpolation=None, strict=True)
    parser.optionxform = str
    parser.read_string("\n".join(lines))  # systemd wants a line for every device
    return parser


def test_the_unit_has_what_the_loop_needs_and_no_more(config):
    parser = parsed(unit(config))
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
    ("cpu", "processors", "expected"),
    [(None, {0, 1}, "0 1"), (1, {0, 1}, "0"), (0, {0, 1, 2, 3}, "1 2 3"), (0, {0}, "0"),
     (7, {0, 1}, "0 1")],
)  # fmt: skip
def test_the_processor_of_the_loop_is_reserved_for_it(config, cpu, processors, expected):
    text = unit(config, "robot", frozenset(processors), real_time=RealTimeOptions(cpu=cpu))
    assert parsed(text)["Service"]["CPUAffinity"] == expected


def complaints(path):
    """What systemd says about a unit."""
    verdict = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True)
    ours = [line for line in verdict.stderr.splitlines() if "dropstitch" in line]
    return "\n".join(ours) if ours or verdict.returncode == 0 else verdict.stderr


@pytest.mark.parametrize("name", ["robot.toml", 'my "robot" 100% $HOME.toml'])
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit_and_its_exposure_is_low(tmp_path, config, name):
    path = tmp_path / "root" / SERVICE_PATH
    assert install(config.rename(tmp_path / name), tmp_path / "root", "--user", "robot") == 0
    assert complaints(path) == ""
    command = ["systemd-analyze", "security", "--offline=yes", "--no-pager", path]
    result = subprocess.run(command, capture_output=True, text=True)
    if "unrecognized option" not in result.stderr:  # needs systemd 250
        exposure = re.search(r"Overall exposure level for \S+: ([0-9.]+)", result.stdout)
        assert exposure, result.stderr
        assert float(exposure[1]) <= 4.0, "without hardening it is 9.6"
    path.write_text(path.read_text().replace("WatchdogSec=2", "WatchdogSec=soon"))
    assert "ignoring: soon" in complaints(path), "it does complain where it has reason to"


def test_the_rule_sets_the_latency_timer_of_ftdi_adapters(config, capsys):
    assert main(["install-service", "--config", str(config), "--dry-run", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    (rule,) = [line for line in files[RULE_PATH].splitlines() if not line.startswith("#")]
    parts = dict(re.fullmatch(r"(\S+?)(==|=)(\".*\")", p).group(1, 2) for p in rule.split(", "))
    assert parts == {"ACTION": "==", "SUBSYSTEM": "==", "DRIVER": "==", "ATTR{latency_timer}": "="}
    assert 'ATTR{latency_timer}="1"' in rule


def test_root_and_an_existing_user_are_needed_before_anything_is_written(
    config, monkeypatch, capsys
):
    monkeypatch.setattr("firmware_py.commands.install_service._write", pytest.fail)
    for user_id, options, words in (
        (1000, [], "needs root"),
        (0, ["--user", "nobody-of-this-name"], "does not exist"),
    ):
        monkeypatch.setattr("os.geteuid", lambda user_id=user_id: user_id)
        assert install(config, "/", *options) == 2
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1
        assert main(["install-service", "--config", str(config), "--dry-run"]) == 0


@pytest.mark.parametrize(
    "user", ["robot\nExecStart=/bin/sh", "", "-robot", "a b", "%u", "$USER", "0"]
)
def test_a_user_that_is_no_user_name_is_refused(tmp_path, config, user, capsys):
    assert install(config, tmp_path / "root", f"--user={user}") == 2
    assert "is no user name" in capsys.readouterr().err
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize("mark", ["\n", "\x1b", "\u2028", "\udcff"])
def test_a_path_with_a_line_break_is_refused(tmp_path, config, mark, capsys):
    directory = tmp_path / f"a{mark}ExecStartPre=b"
    directory.mkdir()
    assert install(config.rename(directory / "robot.toml"), tmp_path / "root") == 2
    assert "control character" in capsys.readouterr().err
    assert not (tmp_path / "root").exists()


def test_a_directory_of_the_configuration_writes_no_directive(config):
    text, value = config.read_text(), "x\\nUser=root/line"
    for changed in (f'logs = "{value}"\n{text}', text.replace("/dev/ttyUSB0", f"unix:{value}")):
        config.write_text(changed)
        with pytest.raises(InputError, match="control character"):
            unit(config)


@pytest.mark.parametrize("dangling", [True, False])
def test_a_symbolic_link_at_the_path_of_the_unit_is_not_followed(
    tmp_path, config, dangling, capsys
):
    other, path = tmp_path / "other", tmp_path / "root" / SERVICE_PATH
    path.parent.mkdir(parents=True)
    if not dangling:
        other.write_text("precious")
    path.symlink_to(other)
    assert install(config, tmp_path / "root") == 2
    assert "is a symbolic link to" in capsys.readouterr().err
    assert other.exists() is not dangling
    assert dangling or other.read_text() == "precious"


def directives(config):
    """Hardening of the unit."""
    text = unit(config, "root")
    lines = text[text.index("AmbientCapabilities=") :].splitlines()
    return [line for line in lines if line and line[0] != "#"]


def test_the_service_reaches_its_port_and_its_logs(config):
    lines = directives(config)
    assert {"DeviceAllow=char-ttyUSB rw", f"ReadWritePaths=-{config.parent}/logs"} <= set(lines)
    assert not {"PrivateDevices=yes", "RestrictRealtime=yes"} & set(lines)
    config.write_text(MINIMAL.replace("/dev/ttyUSB0", "unix:/tmp/my line/socket"))
    assert '\nBindReadOnlyPaths="-/tmp/my line"\n' in unit(config), "PrivateTmp would hide it"


REAL_TIME = """
import os
from firmware_py.system.clock import RealTimeOptions, real_time
with real_time(RealTimeOptions(priority=50)) as refused:
    assert not refused, refused
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    locked = next(l for l in open("/proc/self/status") if l.startswith("VmLck"))
    assert int(locked.split()[1]) > 10_000, locked
"""


def bounded_by(lines):
    """Command with the rights of the service, as user 65534, without systemd."""
    values = dict(line.split("=", 1) for line in lines)
    assert values["NoNewPrivileges"] == "yes"
    assert values["AmbientCapabilities"] == values["CapabilityBoundingSet"]
    names = [name.removeprefix("CAP_").lower() for name in values["AmbientCapabilities"].split()]
    rights = ",".join(["-all", *(f"+{name}" for name in names)])
    sets = [f"--{name}={rights}" for name in ("bounding-set", "inh-caps", "ambient-caps")]
    return ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "--no-new-privs", *sets]


@pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv"
)
def test_the_rights_of_the_service_are_enough_for_real_time(config):
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


def test_a_configuration_that_is_a_loop_of_links_gets_one_sentence(tmp_path, capsys):
    (tmp_path / "loop").symlink_to("loop")
    words = ["install-service", "--config", str(tmp_path / "loop"), "--user", "robot", "--dry-run"]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "loop: " in error and error.count("\n") == 1
