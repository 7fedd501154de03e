"""Loading of a bundle: hashes, golden ticks, gains of its servos, and refusals."""

import functools
import json
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS, ServoGains
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.errors import InputError
from firmware_py.core.signals import tick_dtype
from firmware_py.inference.bundle import ModelBundle, read_manifest
from firmware_py.inference.golden import GOLDEN, read_golden, write_golden
from firmware_py.inference.manifest import Manifest, write_manifest
from firmware_py.log.recorder import recording
from firmware_py.robot import build_bus, with_bundle_gains
from firmware_py.system.clock import SimClock
from models.commands.identify import read_servo_gains


@pytest.fixture
def bundle(toy_bundle, tmp_path):
    return shutil.copytree(toy_bundle, tmp_path / "bundle")


def refused(bundle, words):
    with pytest.raises(InputError, match=words):
        ModelBundle.load(bundle)


def rewrite_manifest(bundle, **changes):
    """Write the manifest with the hashes of the files that are there now."""
    manifest = msgspec.json.decode((bundle / "manifest.json").read_bytes(), type=Manifest)
    write_manifest(bundle, msgspec.structs.replace(manifest, **changes))


@pytest.mark.parametrize("name", ["predictor.onnx", "lagged.onnx", "plant.json", "golden.npz"])
def test_a_changed_or_missing_file_is_refused_by_name(bundle, name):
    content = bytearray((bundle / name).read_bytes())
    content[len(content) // 2] ^= 1
    (bundle / name).write_bytes(content)
    refused(bundle, rf"{name}.*hash")
    (bundle / name).unlink()
    refused(bundle, rf"{name}.*missing")


def test_the_plant_is_the_one_whose_hash_was_verified(bundle):
    loaded = ModelBundle.load(bundle)
    assert loaded.plant == json.loads((bundle / "plant.json").read_text())
    (bundle / "plant.json").unlink()
    rewrite_manifest(bundle)
    (bundle / "plant.json").write_text('{"parameters": {}}')  # a file that the manifest lacks
    assert ModelBundle.load(bundle).plant == {}


@pytest.mark.parametrize("name", ["di", "tip_m"])
def test_a_golden_tick_that_differs_beyond_rounding_is_refused(bundle, name):
    golden = read_golden(bundle / GOLDEN, 1)
    for difference in (5e-10, 2e-9):
        changed = getattr(golden, name).copy()
        changed[7] += difference
        write_golden(bundle / GOLDEN, golden._replace(**{name: changed}))
        rewrite_manifest(bundle)
        if difference < 1e-9:
            ModelBundle.load(bundle)
    refused(bundle, f"tick 7: {name}")


def test_golden_ticks_are_needed_for_the_joints_of_the_robot(bundle):
    with pytest.raises(InputError, match="2 joints"):
        read_golden(bundle / GOLDEN, 2)
    (bundle / GOLDEN).unlink()
    rewrite_manifest(bundle)
    refused(bundle, r"names no golden\.npz")


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


# --- manifest -----------------------------------------------------------------------------------


def test_every_manifest_that_was_cut_off_asks_for_another_copy(bundle):
    path = bundle / "manifest.json"
    whole = path.read_bytes()
    for size in range(0, len(whole), 97):
        path.write_bytes(whole[:size])
        refused(bundle, r"manifest\.json: is damaged.*; copy the bundle again")
    path.unlink()
    refused(bundle, r"manifest\.json.*missing")


def damage_manifest(bundle, change):
    """Change the JSON of the manifest without its hash."""
    path = bundle / "manifest.json"
    document = json.loads(path.read_bytes())
    path.write_text(json.dumps(change(document) or document), encoding="utf-8")


@pytest.mark.parametrize(
    ("keys", "to"),
    [
        (("period_s",), 0.016),
        (("features", 0, "maximum"), 5.25),
        (("training_data_sha256",), "0" * 64),
        (("files",), {}),
        (("content_sha256",), "0" * 64),
    ],
)
def test_a_changed_value_in_the_manifest_is_refused(bundle, keys, to):
    def change(document):
        *path, last = keys
        functools.reduce(lambda part, key: part[key], path, document)[last] = to

    damage_manifest(bundle, change)
    refused(bundle, r"manifest\.json: does not match.*; copy the bundle again")


def test_the_layout_of_a_manifest_does_not_count_but_its_hash_and_its_schema_do(bundle):
    before = read_manifest(bundle)
    damage_manifest(bundle, lambda document: dict(sorted(document.items(), reverse=True)))
    assert read_manifest(bundle) == before
    rewrite_manifest(bundle, schema=2)
    refused(bundle, r"has schema version 2, .*dropstitch train")
    rewrite_manifest(bundle, schema=before.schema)
    damage_manifest(bundle, lambda document: document.pop("content_sha256") and None)
    refused(bundle, r"has no content_sha256.*dropstitch train")


# --- gains that a plant was identified with -----------------------------------------------------

ROBOT = Path("robot.toml")


def robot_of(gains=None):
    servo = ServoConfig(id=1, model="H54-200-S500-R", gains=gains)
    return RobotConfig(bundle="b", bus=BusConfig(port="p"), servos=(servo,))


def with_gains(bundle, *gains):
    """The bundle, loaded with other gains in its manifest."""
    write_manifest(bundle, msgspec.structs.replace(read_manifest(bundle), servo_gains=gains))
    return ModelBundle.load(bundle)


def test_the_servo_must_have_the_gains_of_the_bundle(bundle):
    config = with_bundle_gains(robot_of(), with_gains(bundle, ServoGains(position_p=32)), ROBOT)
    for gain, fits in ((32, True), (31, False)):
        transport = LoopbackTransport({1: MODELS[54024]})
        transport.put(1, Register.POSITION_P_GAIN, gain)
        bus = build_bus(config, transport, SimClock())
        if fits:
            bus.connect()
        else:
            with pytest.raises(InputError, match="identified with 32"):
                bus.connect()
        assert transport.get(1, Register.TORQUE_ENABLE) == 0


def test_gains_of_the_file_and_of_the_bundle_are_merged_or_refused(bundle):
    loaded = with_gains(bundle, ServoGains(position_p=32))
    with pytest.raises(InputError, match=r"position_p = 31, the bundle's .* with 32"):
        with_bundle_gains(robot_of(ServoGains(position_p=31)), loaded, ROBOT)
    both = with_bundle_gains(robot_of(ServoGains(velocity_i=14)), loaded, ROBOT).servos[0].gains
    assert (both.position_p, both.velocity_i) == (32, 14)


def test_a_gain_that_the_servo_lacks_is_refused(bundle):
    with pytest.raises(InputError, match="has no Position D Gain"):
        with_bundle_gains(robot_of(), with_gains(bundle, ServoGains(position_d=1)), ROBOT)


@pytest.mark.parametrize("gains", [(ServoGains(),) * 3, (ServoGains(position_p=-1),)])
def test_gains_of_a_manifest_have_bounds(bundle, gains):
    with pytest.raises(InputError, match="servo_gains"):
        with_gains(bundle, *gains)


def test_gains_are_read_from_a_log(tmp_path):
    path = tmp_path / "run.mcap"

    def log(settings):
        path.unlink(missing_ok=True)
        with recording(path, 1, 0, {"servo_settings": settings}) as telemetry:
            telemetry.put(np.zeros(1, tick_dtype(1))[0])

    log(json.dumps([{"Position P Gain": 640, "Velocity I Gain": 14, "Drive Mode": 0}]))
    assert read_servo_gains(path) == (ServoGains(position_p=640, velocity_i=14),)
    log("[" * 100_000)
    with pytest.raises(InputError, match="holds damaged settings"):
        read_servo_gains(path)


def test_gains_are_read_from_the_file_of_a_robot(tmp_path):
    path = tmp_path / "robot.toml"
    text = 'bundle = "b"\n[bus]\nport = "p"\n[[servos]]\nid = 1\nmodel = "H54-200-S500-R"\n'
    path.write_text(f"{text}gains = {{ position_p = 32 }}\n", encoding="utf-8")
    assert read_servo_gains(path) == (ServoGains(position_p=32),)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="does not give the gains"):
        read_servo_gains(path)
