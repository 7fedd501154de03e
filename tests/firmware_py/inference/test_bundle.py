"""Loading of a bundle: hashes, golden ticks, and refusals."""

import shutil

import msgspec
import numpy as np
import pytest

from firmware_py.errors import InputError
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.golden import GOLDEN, read_golden, record_golden, verify, write_golden
from firmware_py.inference.manifest import Manifest, write_manifest


@pytest.fixture
def bundle(toy_bundle, tmp_path):
    return shutil.copytree(toy_bundle, tmp_path / "bundle")


def test_a_whole_bundle_loads_and_predicts(bundle):
    loaded = ModelBundle.load(bundle)
    golden = read_golden(bundle / GOLDEN, 1)
    again = record_golden(
        loaded.estimator, loaded.predictor, golden.angle_rad, golden.current_a, golden.step_s
    )
    np.testing.assert_array_equal(again.tip_m, golden.tip_m)
    assert golden.step_s == pytest.approx(loaded.manifest.period_s)


@pytest.mark.parametrize(
    "name", ["predictor.onnx", "lagged.onnx", "plant.json", "study.json", "golden.npz"]
)
def test_one_changed_byte_is_refused_and_the_file_named(bundle, name):
    content = bytearray((bundle / name).read_bytes())
    content[len(content) // 2] ^= 1
    (bundle / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"{name}.*hash"):
        ModelBundle.load(bundle)


@pytest.mark.parametrize("name", ["predictor.onnx", "golden.npz", "manifest.json"])
def test_a_missing_file_is_named(bundle, name):
    (bundle / name).unlink()
    with pytest.raises(InputError, match=rf"{name}.*missing"):
        ModelBundle.load(bundle)


@pytest.mark.parametrize("name", ["di", "tip_m"])
def test_a_golden_tick_that_differs_is_refused_even_under_a_right_hash(bundle, name):
    golden = read_golden(bundle / GOLDEN, 1)
    changed = getattr(golden, name).copy()
    changed[7] += 2e-9
    write_golden(bundle / GOLDEN, golden._replace(**{name: changed}))
    write_manifest(bundle, read_manifest_unchecked(bundle))
    with pytest.raises(InputError, match=f"tick 7: {name}"):
        ModelBundle.load(bundle)


def read_manifest_unchecked(bundle):
    return msgspec.json.decode((bundle / "manifest.json").read_bytes(), type=Manifest)


def test_a_difference_within_rounding_is_not(bundle):
    loaded = ModelBundle.load(bundle)
    golden = read_golden(bundle / GOLDEN, 1)
    close = golden._replace(tip_m=golden.tip_m + 5e-10)
    verify(close, loaded.estimator, loaded.predictor, bundle / GOLDEN)


def test_a_bundle_without_golden_ticks_is_refused(bundle):
    (bundle / GOLDEN).unlink()
    write_manifest(bundle, read_manifest_unchecked(bundle))
    with pytest.raises(InputError, match=r"names no golden\.npz"):
        ModelBundle.load(bundle)


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"{", "manifest.json"), (b'{"schema": 1}', "dof"), (b"[]", "array"), (b"", "manifest.json")],
)
def test_a_damaged_manifest_is_one_sentence(bundle, content, said):
    (bundle / "manifest.json").write_bytes(content)
    with pytest.raises(InputError, match=said):
        ModelBundle.load(bundle)


def test_another_schema_is_refused(bundle):
    manifest = read_manifest(bundle)
    write_manifest(bundle, msgspec.structs.replace(manifest, schema=2))
    with pytest.raises(InputError, match="schema is 2"):
        ModelBundle.load(bundle)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"text"])
def test_damaged_golden_ticks_are_named(bundle, content):
    (bundle / GOLDEN).write_bytes(content)
    with pytest.raises(InputError, match=r"golden\.npz"):
        read_golden(bundle / GOLDEN, 1)


def one_tick(golden):
    parts = {name: getattr(golden, name)[:1] for name in golden._fields if name != "step_s"}
    return golden._replace(**parts)


def one_step(golden):
    stands = np.zeros_like(golden.angle_rad)
    stands[len(stands) // 2 :] = 0.3
    return golden._replace(angle_rad=stands)


@pytest.mark.parametrize(
    "change",
    [
        one_tick,
        one_step,
        lambda golden: golden._replace(tip_m=golden.tip_m * np.nan),
        lambda golden: golden._replace(di=golden.di + np.inf),
        lambda golden: golden._replace(angle_rad=golden.angle_rad * np.nan),
        lambda golden: golden._replace(angle_rad=golden.angle_rad * 0.0),
        lambda golden: golden._replace(step_s=np.nan),
        lambda golden: golden._replace(step_s=-0.017),
        lambda golden: golden._replace(step_s=1e9),
    ],
)
def test_golden_ticks_that_prove_nothing_are_refused(bundle, change):
    write_golden(bundle / GOLDEN, change(read_golden(bundle / GOLDEN, 1)))
    with pytest.raises(InputError, match="proves nothing"):
        read_golden(bundle / GOLDEN, 1)


def test_golden_ticks_of_another_robot_are_refused(bundle):
    with pytest.raises(InputError, match="2 joints"):
        read_golden(bundle / GOLDEN, 2)
