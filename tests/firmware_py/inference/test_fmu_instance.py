"""FMU instance of the robot, against FMPy on the same FMU; and refusals."""

import platform
import tracemalloc

import numpy as np
import pytest

from firmware_py.core.errors import FmuRefusal, InputError
from firmware_py.core.signals import PERIOD_S
from firmware_py.inference.fmu_instance import FmuInstance
from fmu.fmpy_instance import FmuArchive
from fmu.fmu_builder import build_fmu
from fmu.fmu_checker import varying_steps_s
from tests.fmu.toy import moving_inputs, pendulum, rewritten

INPUTS = ["torque_nm", "payload_kg"]
OUTPUTS = ["tip_x_m", "tip_z_m", "torque_filtered_nm", "steps", "mass_kg", "time"]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return build_fmu(pendulum(), tmp_path_factory.mktemp("unit") / "pendulum.fmu")


@pytest.fixture
def fmu(path):
    with FmuInstance(path) as fmu:
        yield fmu


def test_steps_equal_fmpys_bit_by_bit(fmu, path):
    u, steps_s = moving_inputs(120), varying_steps_s(120)
    with FmuArchive(path) as archive, archive.instance() as instance:
        expected = instance.run(INPUTS, u, steps_s, OUTPUTS)
    inputs, outputs = fmu.channel(INPUTS), fmu.channel(OUTPUTS)
    for k, step_s in enumerate(steps_s):
        inputs.values[:] = u[k]
        inputs.send()
        fmu.step(step_s)
        outputs.receive()
        np.testing.assert_array_equal(outputs.values, expected[k + 1])
    assert fmu.time_s == expected[-1, -1]


def test_what_is_set_before_the_first_step_shapes_the_first_state(fmu):
    fmu.set(["parameters.rest_rad", "parameters.length_m"], [0.5, 1.0])
    fmu.set(["payload_kg"], [0.0])
    assert fmu.get(["tip_x_m"])[0] == pytest.approx(np.sin(0.5), abs=1e-12)
    fmu.set(["parameters.rest_rad"], [0.1])
    assert fmu.get(["in_range", "parameters.rest_rad"]).tolist() == [1.0, 0.1]
    fmu.set(["parameters.rest_rad"], [1.5])
    assert fmu.get(["in_range"])[0] == 0.0, "a Boolean is read as 1 or 0"


def test_a_refused_call_names_the_cause_and_the_fmu_goes_on(fmu):
    with pytest.raises(FmuRefusal, match=r"torque_nm .* not a finite number"):
        fmu.set(["torque_nm"], [np.nan])
    with pytest.raises(FmuRefusal, match="length_m = 9 lies outside"):
        fmu.set(["parameters.length_m"], [9.0])
    with pytest.raises(FmuRefusal, match="step of 0 s"):
        fmu.step(0.0)
    fmu.step(PERIOD_S)
    with pytest.raises(InputError, match="no variable torque_2_nm"):
        fmu.channel(["torque_2_nm"])
    with pytest.raises(InputError, match="in_range is no Float64"):
        fmu.channel(["in_range"])


def test_a_tick_leaves_nothing_allocated(fmu):
    inputs, outputs = fmu.channel(INPUTS), fmu.channel(["tip_x_m", "steps"])

    def ticks(count):
        for _ in range(count):
            inputs.values[0] = 0.5
            inputs.send()
            fmu.step(PERIOD_S)
            outputs.receive()

    ticks(50)
    tracemalloc.start()
    ticks(50)
    before = tracemalloc.get_traced_memory()[0]
    ticks(500)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 500  # bytes: less than one a tick


def _edit(old, new):
    def change(files):
        files["modelDescription.xml"] = files["modelDescription.xml"].replace(old, new)

    return change


def _no_elf(files):
    files[next(n for n in files if n.endswith(".so"))] = b"no library"


def _cut(files):
    """As after a full disk; the loader maps such a file, and using it would kill the process."""
    name = next(n for n in files if n.endswith(".so"))
    files[name] = files[name][:9000]


def _lacking(files):
    name = next(n for n in files if n.endswith(".so"))
    files[name] = files[name].replace(b"fmi3DoStep\0", b"fmi3DoStop\0")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (_edit(b'fmiVersion="3.0"', b'fmiVersion="2.0"'), "is of FMI 2.0"),
        (_edit(b'instantiationToken="{', b'instantiationToken="{0'), "token is of another FMU"),
        (_edit(b"<CoSimulation", b"<ModelExchange"), "not for Co-Simulation"),
        (_edit(b"<ModelVariables>", b"<ModelVariables"), "is no FMU"),
        (lambda files: files.pop("modelDescription.xml"), "is no FMU"),
        (_edit(b'valueReference="1"', b'valueReference="one"'), "is no FMU"),
        (_no_elf, "does not load"),
        (_cut, "does not load .*cut short"),
        (_lacking, "lacks fmi3DoStep"),
    ],
)
def test_a_damaged_fmu_is_refused(path, tmp_path, change, sentence):
    with pytest.raises(InputError, match=sentence):
        FmuInstance(rewritten(path, tmp_path / "bad.fmu", change))


def test_a_machine_without_a_binary_is_named(path, monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(InputError, match=r"no binary for riscv64-linux, only for x86_64-linux"):
        FmuInstance(path)
