"""The command `models plan`: options that contradict each other or would change nothing."""

import pytest

from firmware_py.inference.manifest import Manifest, write_manifest
from firmware_py.signals import PERIOD_S
from models.__main__ import main
from models.plant.plant import NOMINAL


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    directory = tmp_path_factory.mktemp("bundle")
    manifest = Manifest(
        dof=1, period_s=PERIOD_S, degree=1, estimator="none", features=(), outputs=(),
        lag_ticks=(0,), training_data_sha256="", plant_sha256="", libraries={}, metrics={},
        coefficients={}, files={},
    )  # fmt: skip
    write_manifest(directory, manifest)
    return directory


@pytest.mark.parametrize(
    ("path", "options", "sentence"),
    [
        ("line", ["--zvd"], "--zvd: is for point_to_point; leave it out"),
        ("point_to_point", ["--rigid", "--zvd"], "--zvd: is given beside --rigid; leave one out"),
        ("line", ["--fastest"], "--fastest: is for the inverse of point_to_point"),
        ("point_to_point", ["--fastest", "--move", "1"], "without --move; leave it out"),
        ("own.CSV", ["--size", "0.1"], "has its own size, place and time; leave --size"),
        ("own.CSV", ["--out", "own.svg"], "is the name of the picture"),
    ],
)
def test_options_that_do_not_fit_are_refused(bundle, tmp_path, capsys, path, options, sentence):
    out = tmp_path / "plan.json"
    words = ["plan", path, "--plant", NOMINAL, "--bundle", bundle, "--out", out, *options]
    assert main([str(word) for word in words]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
