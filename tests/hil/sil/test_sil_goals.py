"""Goals of another program on the virtual line: the run is its, and leaves log and trial."""

import json
import threading

import pytest

from firmware_py.errors import InputError
from firmware_py.goals.outside.for_robot import outside_goals
from firmware_py.goals.outside.goal_channel import connect
from firmware_py.log.recording import read_recording
from hil.__main__ import main
from hil.sil import run_sil, write_results
from hil.sil.sil_loop import LOG_NAME
from hil.sil.sil_options import sil_config
from models.trials.trial_files import read_trial
from tests.firmware_py.goals.outside.scripted_program import linear_map, swinging
from tests.hil.sil.test_sil_plan import bundle, fmu, options, plan  # noqa: F401

TICKS = 60


def program(address):
    """Swing for some ticks, then end the run."""
    while True:
        try:
            connection = connect(address)
            break
        except InputError:
            continue
    with connection:
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
    with outside_goals(address, None, sil_config(alone, "virtual"), patience_s=5.0) as goals:
        chosen = options(plan=None, seconds=3.0, goals=goals)
        result = run_sil(chosen)
        timing = write_results(result, chosen)
    thread.join()
    assert timing.run.reason == "the program that sends the goals has ended the run"
    assert timing.run.programme_s == {"motion": 3.0}
    own = result.records[result.records["tick"] >= 1][: TICKS - 2]
    wanted = [swinging({"tick": 0, "time_s": (k - 1) * 0.017})["joint_rad"][0] for k in own["tick"]]
    assert own["goal_1_rad"] == pytest.approx(wanted, abs=1e-9)
    assert read_trial(tmp_path / "trial" / "sil.csv").meta.motion == "outside"
    log = read_recording(tmp_path / LOG_NAME)
    assert json.loads(log.metadata["motion"])["motion"] == "outside"


def test_a_map_without_goals_is_refused_as_on_the_robot(tmp_path, capsys):
    words = f"sil --bundle {tmp_path} --out {tmp_path}/out --line virtual --map P.json"
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert said == "python -m hil: --map: is given without --goals; leave it out.\n"


def test_a_map_for_another_robot_is_refused(options, tmp_path):  # noqa: F811
    from firmware_py.documents import write_document

    config = sil_config(options(plan=None), "virtual")
    write_document(tmp_path / "map.json", linear_map(2))
    with (
        pytest.raises(InputError, match="is for 2 joints, the robot has 1"),
        outside_goals(f"unix:{tmp_path}/goals", tmp_path / "map.json", config),
    ):
        pass
