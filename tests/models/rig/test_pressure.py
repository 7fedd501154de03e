"""Pressure in both engines: bending by prestress, shear by its pull, limit in proportion."""

import numpy as np
import pytest

from firmware_py.link.link_description import LinkDescription
from models.rig.hinged import BendLaw
from models.rig.parameters import link_stiffness, rig_of_link
from models.rig.rod import SectionLaw

PLAIN = {
    "memory.hysteresis_share": 0.0, "memory.relaxing_share": 0.0, "stiffness.damping_s": 0.0,
    "stiffness.directional_share": 0.0, "stiffness.prebend_rad": 0.0,
}  # fmt: skip


def root_moment_nm(engine, parameters, bend_rad):
    bend = np.zeros((9, 2))
    bend[0, 0] = bend_rad
    if engine == "rod":
        return SectionLaw(parameters, 1e-3, 8).advance(bend)[0][0, 0]
    return -BendLaw(parameters, 1e-3).torque_nm(bend)[0, 0]


@pytest.mark.parametrize("engine", ["hinges", "rod"])
@pytest.mark.parametrize("pressure_pa", [20_000.0, 41_300.0, 80_000.0])
def test_the_root_gains_by_prestress_and_its_limit_in_proportion(parameters, engine, pressure_pa):
    p = parameters.changed(**PLAIN, **{"stiffness.pressure_pa": pressure_pa})
    gained = (pressure_pa - 41_300.0) * 0.15**4 / 6
    stiffness = root_moment_nm(engine, p, 1e-6) / 1e-6
    assert stiffness == pytest.approx(350.0 * (1 + gained / 135.0), rel=1e-6)
    limit_nm = parameters["stiffness.root_limit_nm"] * pressure_pa / 41_300.0
    assert root_moment_nm(engine, p, 1e4) == pytest.approx(limit_nm, rel=1e-3)


@pytest.mark.parametrize("section", ["square", "round"])
def test_a_described_link_has_the_shear_and_prestress_of_its_section(section, tmp_path):
    def at(pressure_pa):
        link = LinkDescription(width_m=0.2, section=section, pressure_pa=pressure_pa)
        return link_stiffness(rig_of_link(link, tmp_path / "link.toml"))

    low, high = at(20_000.0), at(60_000.0)
    pull_n = 40_000.0 * 0.2**2 * (1.0 if section == "square" else np.pi / 4)
    assert high.shear_n - low.shear_n == pytest.approx(pull_n)
    gained = pull_n * 0.2**2 / (6 if section == "square" else 8)
    assert high.bending_n_m2 - low.bending_n_m2 == pytest.approx(gained)
    assert high.root_limit_nm / low.root_limit_nm == pytest.approx(3.0)
