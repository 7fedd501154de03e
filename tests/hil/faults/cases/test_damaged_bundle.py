"""Damages of a bundle: each is refused for the reason that its row of the fault table names."""

import shutil

import pytest

from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from hil.faults.cases.damaged_bundle import BUNDLE_DAMAGES
from hil.faults.fault_table import PROCESS

ROWS = {row.how: row for row in PROCESS if row.setup.bundle_damage}


def test_every_damage_has_its_row():
    assert ROWS.keys() == BUNDLE_DAMAGES.keys()


@pytest.mark.parametrize("damage", BUNDLE_DAMAGES)
def test_a_damaged_bundle_is_refused_for_its_damage(toy_bundle, tmp_path, damage):
    bundle = shutil.copytree(toy_bundle, tmp_path / "bundle")
    ModelBundle.load(bundle)
    keys = BUNDLE_DAMAGES[damage](bundle)
    with pytest.raises(InputError) as refused:
        ModelBundle.load(bundle, keys)
    assert ROWS[damage].must.reason in str(refused.value)
