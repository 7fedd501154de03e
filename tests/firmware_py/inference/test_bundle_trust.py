"""Trust in a bundle: names and bounds of the manifest, one read of every file, signatures."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed448 import Ed448PrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from dropstitch.__main__ import main as dropstitch
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.bundle_signature import TrustConfig, key_text
from firmware_py.inference.manifest import content_sha256, write_manifest
from firmware_py.robot import load_bundle

# RFC 8032, section 7.1, test 1: secret and public key.
SECRET = bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
PUBLIC = bytes.fromhex("d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a")


@pytest.fixture
def bundle(toy_bundle, tmp_path):
    return shutil.copytree(toy_bundle, tmp_path / "bundle")


def pem(key, encryption=serialization.NoEncryption()):  # noqa: B008
    form = serialization.PrivateFormat.PKCS8
    return key.private_bytes(serialization.Encoding.PEM, form, encryption)


def sign(bundle, key, *options):
    return dropstitch(["sign", str(bundle), "--key", str(key), *options])


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "key.pem"
    path.write_bytes(pem(Ed25519PrivateKey.from_private_bytes(SECRET)))
    return path


def changed(bundle, **changes):
    """The manifest of a bundle with other values, by someone who fits its own hash to them."""
    path = bundle / "manifest.json"
    document = json.loads(path.read_text(encoding="utf-8")) | changes
    document["content_sha256"] = content_sha256(document)
    path.write_text(json.dumps(document), encoding="utf-8")


@pytest.mark.parametrize(
    "name", ["../secret.txt", "/etc/hostname", "sub/predictor.onnx", "notes.txt", "", "a\0b"]
)
def test_a_manifest_that_names_another_file_is_refused(bundle, name):
    (bundle.parent / "secret.txt").write_text("x", encoding="utf-8")
    files = read_manifest(bundle).files
    changed(bundle, files=files | {name: "0" * 64})
    with pytest.raises(InputError, match="is no file of a bundle"):
        ModelBundle.load(bundle)


@pytest.mark.parametrize(("estimator", "name"), [("lagged", "lagged.onnx"), ("observer", "observ")])
def test_a_file_that_runs_but_is_not_named_is_refused(bundle, estimator, name):
    files = read_manifest(bundle).files
    (bundle / "observer.fmu").write_bytes(b"put here later")
    changed(bundle, estimator=estimator, files={k: v for k, v in files.items() if name not in k})
    with pytest.raises(InputError, match=f"names no {name}"):
        ModelBundle.load(bundle)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"dof": 1_000_000_000}, "dof is 1000000000, outside 1 to 2"),
        ({"period_s": -0.017}, "period_s"),
        ({"lag_ticks": [10**9]}, "lag_ticks"),
        ({"lag_ticks": []}, "lag_ticks is empty"),
        ({"metrics": {"a_m": 1e300}}, "metric 'a_m'"),
        ({"outputs": [{"name": "x", "unit": "m", "minimum": 1.0, "maximum": 0.0}]}, "range of 'x'"),
    ],
)
def test_numbers_out_of_bounds_are_refused(bundle, changes, words):
    changed(bundle, **changes)
    with pytest.raises(InputError, match=words):
        ModelBundle.load(bundle)


def test_a_bundle_of_0_3_0_lists_coefficients_and_is_loaded(bundle):
    changed(bundle, coefficients={"1": [0.5], "di^2": [-3.0]})
    assert ModelBundle.load(bundle)


def test_every_file_is_read_once(bundle, monkeypatch):
    """What is swapped after the check cannot be loaded: nothing is opened a second time."""
    opened, plain = [], os.open
    monkeypatch.setattr(os, "open", lambda p, *rest, **k: opened.append(p) or plain(p, *rest, **k))
    ModelBundle.load(bundle)
    names = [Path(p).name for p in opened if bundle in Path(str(p)).parents]
    assert sorted(names) == sorted([*read_manifest(bundle).files, "manifest.json"])


def test_a_signed_bundle_is_trusted_by_its_key_alone(bundle, key, capsys):
    public = key_text(PUBLIC)
    with pytest.raises(InputError, match="is not signed"):
        ModelBundle.load(bundle, [public])
    assert sign(bundle, key, "--json") == 0
    assert json.loads(capsys.readouterr().out)["key"] == public
    assert ModelBundle.load(bundle, [key_text(bytes(32)), public]).signature.key == public
    assert ModelBundle.load(bundle).signature is None
    with pytest.raises(InputError, match=r"which \[trust\] does not name"):
        ModelBundle.load(bundle, [key_text(bytes(32))])


def test_a_bundle_that_was_changed_after_the_signature_is_refused(bundle, key):
    assert sign(bundle, key) == 0
    trusted = [key_text(PUBLIC)]
    changed(bundle, degree=7)
    with pytest.raises(InputError, match="was changed after it was signed"):
        ModelBundle.load(bundle, trusted)
    write_manifest(bundle, msgspec.structs.replace(read_manifest(bundle), degree=3))
    with pytest.raises(InputError, match="is not signed"):  # the old signature is removed
        ModelBundle.load(bundle, trusted)
    assert sign(bundle, key) == 0
    content = bytearray((bundle / "predictor.onnx").read_bytes())
    content[100] ^= 1
    (bundle / "predictor.onnx").write_bytes(content)
    with pytest.raises(InputError, match=r"predictor\.onnx.*hash"):
        ModelBundle.load(bundle, trusted)


def test_an_older_bundle_of_the_same_key_is_refused(bundle, key, tmp_path):
    robot = tmp_path / "robot.toml"
    servo = ServoConfig(id=1, model="XM430-W350")
    trust = TrustConfig(keys=(key_text(PUBLIC),))
    config = RobotConfig(bundle=str(bundle), bus=BusConfig(port="p"), servos=(servo,), trust=trust)
    signature = bundle / "manifest.sig"
    assert sign(bundle, key) == 0
    older = signature.read_bytes()
    load_bundle(config, robot)
    load_bundle(config, robot)
    assert sign(bundle, key) == 0
    load_bundle(config, robot)
    signature.write_bytes(older)
    with pytest.raises(InputError, match=r"older bundle.*newest-bundle\.json"):
        load_bundle(config, robot)
    memory = tmp_path / "newest-bundle.json"
    memory.write_text(memory.read_text().replace('Z"', '"'))
    with pytest.raises(InputError, match=r"newest-bundle\.json.*timezone"):
        load_bundle(config, robot)
    memory.unlink()
    load_bundle(config, robot)
    memory.unlink()
    memory.mkdir()
    with pytest.raises(InputError, match=r"newest-bundle\.json"):
        load_bundle(config, robot)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "",
        lambda text: "{}",
        lambda text: "[" * 100_000,
        lambda text: text.replace('"schema": 2', '"schema": 3'),
        lambda text: text.replace('"signed_utc": "20', '"signed_utc": "21'),
        lambda text: text.replace('Z"', '"'),
        lambda text: text.replace('"signature": "', '"signature": "AAAA'),
    ],
)
def test_a_damaged_signature_is_one_sentence(bundle, key, change):
    assert sign(bundle, key) == 0
    path = bundle / "manifest.sig"
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(InputError, match=r"manifest\.sig"):
        ModelBundle.load(bundle, [key_text(PUBLIC)])


def test_a_new_key_is_its_owners_alone_and_never_overwritten(bundle, tmp_path, capsys):
    path = tmp_path / "new.pem"
    assert sign(bundle, path, "--new-key") == 0
    assert path.stat().st_mode & 0o777 == 0o600
    assert sign(bundle, path) == 0
    assert sign(bundle, path, "--new-key") == 2
    assert "exists" in capsys.readouterr().err


def test_a_key_of_openssh_signs_too(bundle, tmp_path):
    if shutil.which("ssh-keygen") is None:
        pytest.skip("ssh-keygen is not installed")
    path = tmp_path / "id_ed25519"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", path], check=True)
    assert sign(bundle, path) == 0


@pytest.mark.parametrize("kind", ["missing", "text", "ed448", "encrypted"])
def test_a_file_that_is_no_key_signs_nothing(bundle, tmp_path, kind, capsys, monkeypatch):
    path = tmp_path / "other"

    def nobody(_):
        raise EOFError

    monkeypatch.setattr("getpass.getpass", nobody)
    content = {
        "text": b"no key",
        "ed448": pem(Ed448PrivateKey.generate()),
        "encrypted": pem(Ed25519PrivateKey.generate(), serialization.BestAvailableEncryption(b"a")),
    }
    if kind != "missing":
        path.write_bytes(content[kind])
    assert sign(bundle, path) == 2
    assert "other" in capsys.readouterr().err and not (bundle / "manifest.sig").exists()
