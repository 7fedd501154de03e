"""SSP package: its structure, and a run in FMPy and in libcosim."""

import zipfile

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp

from firmware_py.core.signals import PERIOD_S
from fmu.fmu_models import read_parts
from fmu.packaging import HOST
from fmu.ssp import PATHS, build_ssp

PAYLOAD_KG = 1.5
STEPS = 300


@pytest.fixture(scope="module")
def package(bundle_1dof, tmp_path_factory):
    twin, observer = (read_parts(kind, 1, bundle_1dof) for kind in ("twin", "observer"))
    path = tmp_path_factory.mktemp("ssp") / "link_1dof.ssp"
    return build_ssp(twin, observer, path, payload_kg=PAYLOAD_KG, platforms=(HOST,))


def test_fmpy_runs_the_system(package):
    """FMPy sets no values of the package's parameters: the payload is the start value, 0."""
    result = simulate_ssp(str(package), stop_time=STEPS * PERIOD_S, step_size=PERIOD_S)
    goal = result["twin.goal_1_rad"]
    assert 0.3 < np.ptp(goal) / 2 < 0.5
    tip, estimate = result["twin.tip_x_m"][1:-1], result["observer.tip_x_m"][2:]
    assert np.abs(tip - estimate)[50:].max() < 6e-3
    assert "observer.age_s" not in result.dtype.names


def test_libcosim_runs_the_system(package, tmp_path):
    """With the payload of the package, which the observer finds."""
    execution = pytest.importorskip("libcosimpy.CosimExecution").CosimExecution
    observer = pytest.importorskip("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    with zipfile.ZipFile(package) as archive:
        archive.extractall(tmp_path)
    system = execution.from_ssp_file(ssp_path=str(tmp_path), step_size=round(1e9 * PERIOD_S))
    system.add_observer(observer)
    assert system.simulate_until(target_time=round(10e9))
    indices = {info.name.decode(): info.index for info in system.slave_infos()}
    assert set(indices) == set(PATHS)
    values = {
        (path, v.name.decode()): observer.last_real_values(index, [v.reference])[0]
        for path, index in indices.items()
        for v in system.slave_variables(index)
        if v.name.decode() in ("tip_x_m", "payload_kg")
    }
    assert values["observer", "payload_kg"] == pytest.approx(PAYLOAD_KG, abs=0.02)
    assert values["observer", "tip_x_m"] == pytest.approx(values["twin", "tip_x_m"], abs=0.02)
