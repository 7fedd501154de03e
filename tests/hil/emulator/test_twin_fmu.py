"""Twin behind the emulated servos: it is built for the machine that loads it."""

import platform

import pytest

from firmware_py.core.errors import InputError
from hil.emulator import twin_fmu
from models.plant.plant import NOMINAL


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_the_twin_is_built_for_this_machine(machine, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(twin_fmu, "build_fmu", lambda *_, platforms: asked.extend(platforms))
    twin_fmu.build_twin(NOMINAL, 1, tmp_path)
    assert asked == [f"{machine}-linux"]


def test_a_machine_without_a_target_gets_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(InputError, match="unknown platform 'riscv64-linux'; choose all or some of"):
        twin_fmu.build_twin(NOMINAL, 1, tmp_path)
