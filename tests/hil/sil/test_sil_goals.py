"""Goals of another program on the virtual line: the run is its, and leaves log and trial."""

import contextlib
import dataclasses
import json
import threading

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from firmware_py.goals.for_robot import outside_goals
from firmware_py.goals.goal_channel import connect
from firmware_py.link.link_facts import STUDY_FACTS
from firmware_py.log.recording import read_recording
from hil.commands.sil import describe_sil
from hil.sil import run_sil, write_results
from hil.sil.sil_options import sil_config
from hil.sil.sil_run import LOG_NAME
from models.trials.files import read_trial
from tests.firmware_py.goals.scripted_program import linear_map, swinging
from tests.firmware_py.goals.small_plan import OTHER_PLANT
from tests.hil.sil.test_sil_plan import bundle, fmu, options, plan  # noqa: F401

TICKS = 60


def connected(address):
    """Connection to a robot that may not listen yet."""
    while True:
        with contextlib.suppress(InputError):
            return connect(address)


def program(address):
    """Swing for some ticks, then end the run."""
    with connected(address) as connection:
        while data := connection.recv(4096):
            status = json.loads(data)
            over = status["tick"] >= TICKS
            goals = {"tick": status["tick"], "end": True} if over else swinging(status)
            connection.send(json.dumps(goals).encode())
            if over:
                return


def test_the_run_is_that_of_the_program(options, tmp_path):  # noqa: F811
    address, alone = f"unix:{tmp_path}/goals", options(plan=None, seconds=3.0)
    thread = threading.Thread(target=program, args=(address,))
    thread.start()
    config = sil_config(alone, "virtual")
    with outside_goals(address, None, config, alone.bundle, patience_s=5.0) as goals:
        chosen = options(plan=None, seconds=3.0, goals=goals)
        result = run_sil(chosen)
        timing = write_results(result, chosen)
    thread.join()
    assert timing.run.programme_s == {"motion": 3.0}
    own = result.records[result.records["tick"] >= 1][: TICKS - 2]
    wanted = [swinging({"tick": 0, "time_s": (k - 1) * 0.017})["joint_rad"][0] for k in own["tick"]]
    assert own["goal_1_rad"] == pytest.approx(wanted, abs=1e-9)
    trial = read_trial(tmp_path / "trial" / "sil.csv")
    assert trial.meta.motion == "outside"
    assert trial.meta.amplitude_rad == np.abs(trial.goal_rad).max() > 0.05
    moving = len(trial) - trial.meta.rest_samples
    assert trial.meta.period_s == pytest.approx(moving * trial.step_s, abs=0.018)
    log = read_recording(tmp_path / LOG_NAME)
    assert json.loads(log.metadata["motion"]) == {"motion": "outside"}


def test_a_map_without_goals_is_refused_as_on_the_robot(tmp_path, capsys):
    words = f"sil --bundle {tmp_path} --out {tmp_path}/out --line virtual --goal-map P.json"
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert said == "dropstitch: --goal-map: is given without --goals; leave it out.\n"


def test_a_map_for_another_robot_is_refused(options, tmp_path):  # noqa: F811
    chosen = options(plan=None)
    config = sil_config(chosen, "virtual")
    write_document(tmp_path / "map.json", linear_map(2))
    with (
        pytest.raises(InputError, match="is for 2 joints, the robot has 1"),
        outside_goals(f"unix:{tmp_path}/goals", tmp_path / "map.json", config, chosen.bundle),
    ):
        pass


def test_goals_of_another_plant_are_told_in_the_log_and_the_result(
    options, bundle, plan, tmp_path  # noqa: F811
):  # fmt: skip
    manifest = msgspec.structs.replace(bundle.manifest, plant_sha256="1" * 64)
    trained = dataclasses.replace(bundle, manifest=manifest)
    own = msgspec.structs.replace(plan, plant_sha256="1" * 64, link=STUDY_FACTS)
    other = msgspec.structs.replace(own, plant_sha256="0" * 64)
    assert options(bundle=trained, plan=own).goals_note == ""
    chosen = options(bundle=trained, plan=other, seconds=0.5)
    timing = write_results(run_sil(chosen), chosen)
    note = read_recording(tmp_path / LOG_NAME).metadata["goals_note"]
    assert note.startswith(f"plan line {OTHER_PLANT} {bundle.directory}")
    assert timing.environment.goals_note == note
    assert note in describe_sil(timing, tmp_path).splitlines()


def test_a_map_of_another_plant_is_told_with_the_goals(options, bundle, tmp_path):  # noqa: F811
    manifest = msgspec.structs.replace(bundle.manifest, plant_sha256="1" * 64)
    chosen = options(bundle=dataclasses.replace(bundle, manifest=manifest), plan=None)
    path, address = tmp_path / "map.json", f"unix:{tmp_path}/goals"
    other = msgspec.structs.replace(linear_map(), plant_sha256="0" * 64, link=STUDY_FACTS)
    write_document(path, other)
    thread = threading.Thread(target=lambda: connected(address).close())
    thread.start()
    with outside_goals(address, path, sil_config(chosen, "virtual"), chosen.bundle) as goals:
        assert dataclasses.replace(chosen, goals=goals).goals_note.startswith(
            f"{path} {OTHER_PLANT} {bundle.directory}"
        )
    thread.join()
