"""The robot image: the wheel in a clean environment, without anything of the workshop."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from dropstitch.__main__ import main as dropstitch
from firmware_py.commands.command_table import COMMANDS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]


def run(*command: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A command in the environment of a robot: no path of this checkout."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [str(c) for c in command], capture_output=True, text=True, cwd=cwd, env=env
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    built = run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", out, cwd=ROOT)
    assert built.returncode == 0, built.stderr
    return next(out.glob("dropstitch-*.whl"))


@pytest.fixture(scope="module")
def robot(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin directory of an environment that holds the wheel and its locked dependencies."""
    home = tmp_path_factory.mktemp("robot") / "venv"
    lock = ROOT / "requirements" / "robot.txt"
    if uv := shutil.which("uv"):
        made = run(uv, "venv", "--python", sys.executable, home)
        pip: tuple[str | Path, ...] = (uv, "pip", "install", "--python", home / "bin" / "python")
    else:
        made = run(sys.executable, "-m", "venv", home)
        pip = (home / "bin" / "python", "-m", "pip", "install", "--disable-pip-version-check")
    assert made.returncode == 0, made.stderr
    for arguments in (("--require-hashes", "-r", lock), ("--no-deps", wheel)):
        installed = run(*pip, *arguments)
        assert installed.returncode == 0, installed.stderr
    return home / "bin"


@pytest.fixture(scope="module")
def complete_bundle(toy_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with its observer unit, as the robot gets it."""
    bundle = tmp_path_factory.mktemp("robot") / "bundle"
    shutil.copytree(toy_bundle, bundle)
    plant = str(bundle / "plant.json")
    assert dropstitch(["fmu", "build", str(bundle), "--plant", plant, "--unit", "observer"]) == 0
    return bundle


def test_the_wheel_holds_the_robot_room_and_the_library_and_is_reproducible(
    wheel: Path, tmp_path: Path
) -> None:
    with zipfile.ZipFile(wheel) as archive:
        rooms = {name.split("/")[0] for name in archive.namelist()}
    assert {r for r in rooms if not r.endswith(".dist-info")} == {"firmware_py", "dropstitch"}
    built = run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=ROOT)
    assert built.returncode == 0, built.stderr
    assert (tmp_path / wheel.name).read_bytes() == wheel.read_bytes()


def sbom(wheel: Path) -> dict:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if "/sboms/" in n)
        assert re.fullmatch(r"dropstitch-[\d.]+\.dist-info/sboms/dropstitch\.cdx\.json", name)
        return json.loads(archive.read(name))


def test_the_bill_of_materials_lists_every_locked_library(wheel: Path) -> None:
    lock = (ROOT / "requirements" / "robot.txt").read_text(encoding="utf-8")
    locked = set(re.findall(r"^([a-z0-9-]+)==([^ ]+)", lock, re.MULTILINE))
    # `pip download --python-version` takes markers of the Python that it runs on
    assert len({name for name, _ in locked}) == len(locked) and "python_full_version" not in lock
    components = sbom(wheel)["components"]
    assert {(c["name"], c["version"]) for c in components} == locked
    assert all(c["purl"] == f"pkg:pypi/{c['name']}@{c['version']}" for c in components)
    scopes = {c["name"]: c.get("scope") for c in components}
    assert scopes["onnxruntime"] == "required" and scopes["mcap"] == "optional"
    assert "scope" not in next(c for c in components if c["name"] == "protobuf")
    assert "properties" in next(c for c in components if c["name"] == "cffi")  # its marker


def test_the_bill_of_materials_keeps_to_cyclonedx(wheel: Path) -> None:
    """Required fields, unique references, no dangling ones (ecma-international.org, ECMA-424)."""
    bom = sbom(wheel)
    assert (bom["bomFormat"], bom["specVersion"], bom["version"]) == ("CycloneDX", "1.6", 1)
    subject = bom["metadata"]["component"]
    assert subject["name"] == "dropstitch" and subject["version"] in wheel.name
    assert all({"type", "name", "bom-ref"} <= set(c) for c in [subject, *bom["components"]])
    refs = [subject["bom-ref"], *(c["bom-ref"] for c in bom["components"])]
    assert len(set(refs)) == len(refs)
    for edge in bom["dependencies"]:
        assert {edge["ref"], *edge["dependsOn"]} <= set(refs)
    assert "http" not in json.dumps(bom)


def test_every_command_is_listed_and_those_of_the_robot_have_help(
    robot: Path, tmp_path: Path
) -> None:
    listed = run(robot / "dropstitch", "--help", cwd=tmp_path).stdout
    assert all(f"  {command.name} " in listed for command in COMMANDS)
    for command in COMMANDS:
        if command.module.startswith(("firmware_py.", "dropstitch.")):
            shown = run(robot / "dropstitch", command.name, "--help", cwd=tmp_path)
            assert shown.returncode == 0, shown.stderr
    servos = run(robot / "python", "-m", "dropstitch", "list", "servos", cwd=tmp_path)
    assert servos.returncode == 0 and "XM430-W350" in servos.stdout


@pytest.mark.parametrize("words", [("simulate", "--help"), ("fmu", "build", "B"), ("list", "rigs")])
def test_a_command_of_the_workshop_says_what_to_install(
    robot: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    refused = run(robot / "dropstitch", *words, cwd=tmp_path)
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1
    assert "belongs to the workshop" in refused.stderr and "make setup" in refused.stderr


LIBRARY = """
import sys
import dropstitch
bundle = dropstitch.ModelBundle.load(sys.argv[1])
print(bundle.predict_many([0.0, 0.1], [0.0, 0.2]).tip_m.shape)
try:
    dropstitch.diagnose
except ImportError as error:
    print(error)
"""


def test_the_library_predicts_and_names_what_the_robot_lacks(
    robot: Path, complete_bundle: Path, tmp_path: Path
) -> None:
    shown = run(robot / "python", "-c", LIBRARY, complete_bundle, cwd=tmp_path)
    shape, sentence = shown.stdout.splitlines()
    assert shape == "(2, 3)" and not shown.stderr
    assert sentence.startswith("dropstitch.diagnose belongs to the workshop")


def test_golden_ticks_replay(robot: Path, complete_bundle: Path, tmp_path: Path) -> None:
    replayed = run(robot / "dropstitch", "replay", "--bundle", complete_bundle, cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
