"""A gear with play, displacement in and force out: nested log, names of its own, diagnosis.

The recording comes from scipy: a dead zone with Hunt and Crossley's contact, rounded friction and
an adaptive integrator, none of which the plant has.
"""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dropstitch.__main__ import main
from models.gap.report.gap_json import read_gap_document
from models.plant.plant import read_plant

PLAY_M, RAM_N, LOAD_N = 1.2e-3, 4.0, 9.0
MASS_KG, SPRING_N_M, CONTACT = 2.0, 6e3, 4e5
STRIBECK_M_S = 2e-3

PLANT = """
schema = 1
name = "press, nominal"
drive = { kind = "measured" }
load = { kind = "geared_slide" }
effects = [{ name = "viscous_friction" }]
[signals]
ram = { unit = "m", role = "supply", quantity = "position_1_m" }
push = { unit = "N", role = "measured", quantity = "force_1_n" }
[parameters]
load_mass_1_kg = { value = 2.0, source = "weighed" }
gear_stiffness_1_n_m = { value = 2e5, source = "assumed" }
gear_contact_damping_1_n_s_m = { value = 200.0, source = "assumed" }
load_stiffness_1_n_m = { value = 5e3, bounds = [0.0, 2e4], role = "nuisance" }
load_damping_1_n_s_m = { value = 20.0, bounds = [0.0, 200.0] }
load_friction_1_n = { value = 5.0, bounds = [0.0, 50.0] }
viscous_friction_1_n_s_m = { value = 1.0, bounds = [0.0, 200.0] }
friction_speed_1_m_s = { value = 0.002, source = "assumed" }
coulomb_friction_1_n = { value = 0.0, bounds = [0.0, 50.0] }
backlash_1_m = { value = 0.0, bounds = [0.0, 0.005], source = "half a tooth" }
backlash_torque_1_n = { value = 2.0, bounds = [0.5, 50.0] }
"""
MAP = """
plant = "press.toml"
step_s = 0.005
[trial]
dof = 1
payload_kg = 0.0
trial = 1
motion = { from = "rig.run" }
[columns]
time_s = { from = "samples[].t_ms", unit = "ms" }
ram = { from = "samples[].ram.displacement", unit = "mm" }
push = { from = "samples[].ram.cell.force", unit = "kN" }
"""
TRIED = ("backlash", "coulomb_friction", "joint_elasticity", "load_offset", "sensor_lag")


def recording(amplitude_m, rate_hz, rng):
    """Time, displacement of the ram and force on it."""

    def ram(t):
        w, soft = 2 * np.pi * rate_hz, 1 - np.exp(-((t / 0.3) ** 2))
        wave = np.sin(w * t) + 0.4 * np.sin(2.3 * w * t)
        slope = w * np.cos(w * t) + 0.92 * w * np.cos(2.3 * w * t)
        rise = 2 * t / 0.09 * np.exp(-((t / 0.3) ** 2))
        return amplitude_m * wave * soft, amplitude_m * (slope * soft + wave * rise)

    def touch(gap, rate):
        depth = np.abs(gap) - PLAY_M / 2
        if depth <= 0:
            return 0.0
        return np.sign(gap) * CONTACT * depth**1.1 * max(0.0, 1 + 0.3 * np.sign(gap) * rate)

    def dry(rate):
        return rate / np.sqrt(rate**2 + STRIBECK_M_S**2)

    def motion(t, state):
        place, rate = ram(t)
        force = touch(place - state[0], rate - state[1])
        resist = SPRING_N_M * state[0] + 40.0 * state[1] + LOAD_N * dry(state[1])
        return [state[1], (force - resist) / MASS_KG]

    time_s = np.arange(0, 5, 0.005)
    rack = solve_ivp(
        motion, (0, 5), [0, 0], "LSODA", time_s, max_step=2e-3, rtol=1e-6, atol=1e-8
    ).y  # fmt: skip
    place, rate = ram(time_s)
    force = [touch(a - x, b - v) for a, b, x, v in zip(place, rate, *rack, strict=True)]
    noisy = np.array(force) + RAM_N * dry(rate) + rng.normal(0, 0.3, len(time_s))
    return time_s, place + rng.normal(0, 2e-6, len(time_s)), noisy


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """Logs imported, plant identified and diagnosed by the commands; the directory."""
    out, rng = tmp_path_factory.mktemp("press"), np.random.default_rng(4)
    (out / "press.toml").write_text(PLANT)
    (out / "map.toml").write_text(MAP)
    for number, (amplitude_m, rate_hz) in enumerate([(0.004, 0.5), (0.008, 0.35), (0.003, 0.9)]):
        samples = [
            {"t_ms": 1e3 * t, "ram": {"displacement": 1e3 * x, "cell": {"force": 1e-3 * f}}}
            for t, x, f in zip(*recording(amplitude_m, rate_hz, rng), strict=True)
        ]
        log = out / f"run{number}.json"
        log.write_text(json.dumps({"rig": {"run": log.stem}, "samples": samples}))
        command = ["import", str(log), "--as", "table", "--map", str(out / "map.toml")]
        assert main([*command, "--out", str(out / "trials")]) == 0
    plant, trials = str(out / "identified.json"), str(out / "trials")
    assert main(["identify", trials, "--plant", str(out / "press.toml"), "--out", plant]) == 0
    untried = [e for e in read_plant(plant).applicable() if e not in TRIED]
    known = set(read_plant(plant).effects)
    without = [a for e in untried if e not in known for a in ("--without", e)]
    code = main(["gap", trials, "--plant", plant, "--out", str(out / "gap"), *without])
    assert code == 0
    return out / "gap"


def test_backlash_is_named_first_with_its_size(diagnosed):
    first = read_gap_document(diagnosed / "gap.json").named[0]
    assert first.effect == "backlash" and first.kept
    play_m = read_plant(diagnosed / "plant.json").parameters["backlash_1_m"]
    assert play_m.value == pytest.approx(PLAY_M, rel=0.15)


def test_friction_is_found_on_either_side_of_the_play(diagnosed):
    parameters = read_plant(diagnosed / "plant.json").parameters
    assert parameters["load_friction_1_n"].value == pytest.approx(LOAD_N, rel=0.3)
    assert parameters["coulomb_friction_1_n"].value == pytest.approx(RAM_N, rel=0.4)
