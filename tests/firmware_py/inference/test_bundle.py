"""Loading of a bundle: hashes, golden ticks, and refusals."""

import json
import shutil

import msgspec
import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.golden import GOLDEN, read_golden, verify, write_golden
from firmware_py.inference.manifest import Manifest, write_manifest


@pytest.fixture
def bundle(toy_bundle, tmp_path):
    return shutil.copytree(toy_bundle, tmp_path / "bundle")


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


def test_every_manifest_that_was_cut_off_says_to_copy_the_bundle_again(bundle):
    path = bundle / "manifest.json"
    whole = path.read_bytes()
    for size in range(0, len(whole), 97):
        path.write_bytes(whole[:size])
        with pytest.raises(
            InputError, match=r"manifest\.json: is damaged.*; copy the bundle again"
        ):
            ModelBundle.load(bundle)


def changed_manifest(bundle, *keys, to):
    """The manifest with another value in one place, as damage leaves it."""
    document = json.loads((bundle / "manifest.json").read_bytes())
    place = document
    for key in keys[:-1]:
        place = place[key]
    assert place[keys[-1]] != to
    place[keys[-1]] = to
    (bundle / "manifest.json").write_text(json.dumps(document), encoding="utf-8")


@pytest.mark.parametrize(
    ("keys", "to"),
    [
        (("period_s",), 0.016),
        (("features", 0, "maximum"), 5.25),
        (("training_data_sha256",), "0" * 64),
        (("coefficients", "1", 0), 3.0),
        (("files",), {}),
        (("content_sha256",), "0" * 64),
    ],
)
def test_a_changed_value_in_the_manifest_is_refused(bundle, keys, to):
    changed_manifest(bundle, *keys, to=to)
    with pytest.raises(
        InputError, match=r"manifest\.json: does not match.*; copy the bundle again"
    ):
        ModelBundle.load(bundle)


def test_the_hash_of_a_manifest_is_of_its_values_and_not_of_their_layout(bundle):
    document = json.loads((bundle / "manifest.json").read_bytes())
    reordered = dict(sorted(document.items(), reverse=True))
    (bundle / "manifest.json").write_text(json.dumps(reordered), encoding="utf-8")
    assert read_manifest(bundle).content_sha256 == document["content_sha256"] != ""


def test_a_bundle_without_such_a_hash_is_to_be_made_anew(bundle):
    document = json.loads((bundle / "manifest.json").read_bytes())
    del document["content_sha256"]
    (bundle / "manifest.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError, match=r"has no content_sha256.*dropstitch train"):
        ModelBundle.load(bundle)


def test_another_schema_is_refused(bundle):
    manifest = read_manifest(bundle)
    write_manifest(bundle, msgspec.structs.replace(manifest, schema=2))
    with pytest.raises(InputError, match=r"has schema version 2, .*dropstitch train"):
        ModelBundle.load(bundle)


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
        lambda golden: golden._replace(angle_rad=golden.angle_rad * np.nan),
        lambda golden: golden._replace(angle_rad=golden.angle_rad * 0.0),
        lambda golden: golden._replace(step_s=np.nan),
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
