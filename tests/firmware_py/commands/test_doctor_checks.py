"""Doctor checks on machines made of files."""

import pytest

from firmware_py.commands.doctor_checks import Severity, examine


def machine(tmp_path, **files):
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content + "\n", encoding="utf-8")
    return tmp_path


LATENCY = "sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
GOVERNOR = "sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor"
CLOCK = "sys/devices/system/clocksource/clocksource0/current_clocksource"


def verdict(root, name, granted=True):
    return {f.name: f for f in examine(root, lambda: granted)}[name]


@pytest.mark.parametrize(
    ("name", "files", "expected"),
    [
        ("USB latency timer", {}, Severity.UNCHECKED),
        ("USB latency timer", {LATENCY: "1"}, Severity.GOOD),
        ("USB latency timer", {LATENCY: "2"}, Severity.SPOILS),
        ("USB latency timer", {LATENCY: "16"}, Severity.SPOILS),
        ("USB latency timer", {LATENCY: "1", LATENCY.replace("B0", "B1"): "16"}, Severity.SPOILS),
        ("swap", {"proc/swaps": "Filename Type Size"}, Severity.GOOD),
        ("swap", {"proc/swaps": "Filename Type Size\n/dev/sda2 partition 1"}, Severity.NOTE),
        ("frequency governor", {}, Severity.UNCHECKED),
        ("swap", {}, Severity.UNCHECKED),
        ("clock source", {}, Severity.UNCHECKED),
        ("frequency governor", {GOVERNOR.format(0): "performance"}, Severity.GOOD),
        (
            "frequency governor",
            {GOVERNOR.format(0): "performance", GOVERNOR.format(1): "powersave"},
            Severity.NOTE,
        ),
        ("clock source", {CLOCK: "tsc"}, Severity.GOOD),
        ("clock source", {CLOCK: "hpet"}, Severity.SPOILS),
        ("kernel preemption", {"proc/version": "Linux #1 SMP PREEMPT_RT"}, Severity.GOOD),
        ("kernel preemption", {"proc/version": "Linux #1 SMP PREEMPT_DYNAMIC"}, Severity.GOOD),
        ("kernel preemption", {"proc/version": "Linux #1 SMP"}, Severity.NOTE),
    ],
)
def test_each_finding_follows_its_file(tmp_path, name, files, expected):
    finding = verdict(machine(tmp_path, **files), name)
    assert finding.verdict is expected
    assert bool(finding.remedy) is (expected is not Severity.GOOD)


@pytest.mark.parametrize(("granted", "expected"), [(True, Severity.GOOD), (False, Severity.SPOILS)])
def test_without_real_time_rights_the_timing_is_spoilt(tmp_path, granted, expected):
    assert verdict(tmp_path, "scheduler rights", granted).verdict is expected


def test_the_adapter_at_fault_is_named(tmp_path):
    finding = verdict(machine(tmp_path, **{LATENCY: "16"}), "USB latency timer")
    assert finding.found == "ttyUSB0 16 ms"
    assert "ttyUSB0/latency_timer" in finding.remedy
