"""Offline commands: refusals before the work, no input overwritten, and what they write."""

import json

import control
import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError
from models.commands import goalmap
from models.plan.learning import RecordedRun
from models.plant.identification.evaluation import evaluate_plant
from models.plant.identification.identify import Identification
from models.plant.linear_twin import modes
from models.plant.plant import NOMINAL, read_plant
from models.shared.output_paths import check_output_directory, check_output_file
from models.trials.files import write_trial
from tests.firmware_py.goals.small_plan import small_plan


def run(*words):
    return main([str(word) for word in words])


# --- places of output -----------------------------------------------------------------------------


@pytest.fixture
def place(tmp_path):
    """A directory with a file."""
    (tmp_path / "file.toml").write_text("")
    return tmp_path


def test_a_place_to_write_to_is_checked_before_the_work(place):
    for name in ("new/deeper", "."):
        check_output_directory(place / name, ["other.toml"], [place / "file.toml"])
        check_output_file(place / name / "other.toml", [place / "file.toml"])
    assert [p.name for p in place.iterdir()] == ["file.toml"], "nothing is made"
    for check, name, message in (
        (check_output_directory, "file.toml", "is a file"),
        (check_output_directory, "file.toml/new", "lies under the file"),
        (check_output_file, ".", "is a directory"),
        (check_output_file, "file.toml/new.toml", "lies under the file"),
    ):
        with pytest.raises(InputError, match=message):
            check(place / name)


def test_an_input_is_not_overwritten_by_any_of_its_names(place):
    source = place / "file.toml"
    (place / "second.toml").hardlink_to(source)
    for name in ("new/../file.toml", "second.toml"):
        with pytest.raises(InputError, match="is a file that is read"):
            check_output_file(place / name, [source])
    for name in (".", "new/.."):
        with pytest.raises(InputError, match=r"toml, which is read"):
            check_output_directory(place / name, ["other.toml", "file.toml"], [source])


@pytest.mark.parametrize("words", [["plan", "line"], ["goalmap"], ["linearise"]])
def test_the_plant_that_is_read_is_not_overwritten(bare_bundle, tmp_path, capsys, words):
    plant = tmp_path / "plant.json"
    plant.write_bytes(NOMINAL.read_bytes())
    bundle = [] if words == ["linearise"] else ["--bundle", bare_bundle]
    assert run(*words, "--plant", plant, *bundle, "--out", plant) == 2
    assert "is a file that is read" in capsys.readouterr().err
    assert plant.read_bytes() == NOMINAL.read_bytes()


# --- identify -------------------------------------------------------------------------------------


class FitStarted(Exception):
    """The command has checked its arguments."""


@pytest.fixture
def directory(toy_trials, tmp_path, monkeypatch):
    """Directory with a trial, a plant and a configuration; nothing is fitted."""

    def fit(*_, **__):
        raise FitStarted

    monkeypatch.setattr("models.commands.identify.identify", fit)
    write_trial(toy_trials(1, amplitudes_deg=(30,))[0], tmp_path / "trials")
    for name in ("p.svg", "p.json"):
        read_plant().write(tmp_path / name)
    (tmp_path / "robot.toml").write_text("robot")
    return tmp_path


def identify(directory, plant, out, *options):
    return run("identify", directory / "trials", "--plant", plant, "--out", out, *options)


@pytest.mark.parametrize("name", ["p.svg", "plain"])
def test_a_plant_that_could_not_be_read_again_is_refused(directory, capsys, name):
    assert identify(directory, NOMINAL, directory / "id" / name) == 2
    assert ".json or .toml" in capsys.readouterr().err
    assert not (directory / "id").exists()


@pytest.mark.parametrize("replaced", ["p.svg", "robot.toml", "trials/conditions"])
def test_the_result_of_a_fit_does_not_replace_an_input(directory, capsys, replaced):
    path, plant, out, options = directory / replaced, NOMINAL, directory / replaced, []
    if replaced == "p.svg":  # the picture beside the plant
        plant, out = path, directory / "new" / ".." / "p.json"
    elif replaced == "robot.toml":
        options = ["--gains", path]
    else:
        (path,) = (directory / "trials").glob("*.toml")
        out = path
    before = path.read_bytes()
    assert identify(directory, plant, out, *options) == 2
    assert "is a file that is read" in capsys.readouterr().err
    assert path.read_bytes() == before
    with pytest.raises(FitStarted):  # only the plant that the fit starts from may be replaced
        identify(directory, directory / "p.json", directory / "p.json")


def test_equal_results_give_equal_files(directory, monkeypatch):
    def fit(plant, trials, *_, **__):
        return Identification(plant, (), evaluate_plant(plant, trials), trials)

    monkeypatch.setattr("models.commands.identify.identify", fit)
    for name in ("a.json", "b.json"):
        assert identify(directory, NOMINAL, directory / name) == 0
    for suffix in (".json", ".svg"):
        first, second = ((directory / f"{name}{suffix}").read_bytes() for name in "ab")
        assert first == second


# --- linearise ------------------------------------------------------------------------------------


def test_the_linear_model_is_a_system_of_python_control(tmp_path, capsys):
    out = tmp_path / "linear.json"
    assert run("linearise", "--plant", NOMINAL, "--payload-kg", "2", "--out", out) == 0
    m = json.loads(out.read_text())
    system = control.ss(m["A"], m["B"], m["C"], m["D"], m["dt"])
    assert (system.ninputs, system.noutputs) == (1, len(m["outputs"]))
    assert len(m["states"]) == system.nstates
    tip = m["outputs"].index("tip_x_m")
    low = abs(system(np.exp(0.01j * m["dt"]))[tip, 0])
    assert 0.9 < low < 1.5, "1 rad moves a link of 1 m by about 1 m, and it leans further by itself"
    assert m["margins"][0]["gain_db"] >= 6.0
    text = capsys.readouterr().out
    assert "damping" in text and "gain margin" in text


# --- plan and goalmap -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (["plan", "line", "--zvd"], "--zvd"),
        (["plan", "point_to_point", "--rigid", "--zvd"], "--zvd"),
        (["plan", "line", "--fastest"], "--fastest"),
        (["plan", "point_to_point", "--fastest", "--move", "1"], "--move"),
        (["plan", "a.CSV", "--size", "0.1"], "--size"),
        (["plan", "line", "--probe", "--open-loop"], "--probe"),
        (["plan", "a.CSV", "--out", "a.svg"], "a.svg"),
        (["linearise", "--payload-kg", "9"], "give 0 to 3 kg"),
        (["linearise", "--angle-deg", "1", "2"], "give 1"),
        (["linearise", "--period", "0"], "0.001 to 1 s"),
        (["linearise", "--angle-deg", "nan"], "give 90° at most"),
    ],
)
def test_options_out_of_range_and_contradictory_ones_are_refused(
    bare_bundle, tmp_path, capsys, words, wrong
):
    bundle = ["--bundle", bare_bundle] if words[0] == "plan" else []
    out = ["--out", tmp_path / "out.json"] if "--out" not in words else []
    assert run(*words, "--plant", NOMINAL, *bundle, *out) == 2
    assert wrong in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("payload_kg", "warnings"), [(3.0, 1), (0.5, 0)])
def test_a_recorded_payload_beyond_the_plan_is_a_warning(
    bare_bundle, tmp_path, capsys, monkeypatch, payload_kg, warnings
):
    def recorded(path, plan):
        none = np.zeros((plan.rows, 1))
        return RecordedRun(none, none, none, payload_kg, 1.0, "mocap", "0" * 64)

    def stop(*_):
        raise InputError("the test", "ends here", "go on")

    monkeypatch.setattr("models.plan.learning.read_plan_run", recorded)
    monkeypatch.setattr("models.plan.learning.improve_plan", stop)
    plan = tmp_path / "plan.json"
    write_document(plan, small_plan(bare_bundle))
    words = ["plan", plan, "--improve", tmp_path / "run.csv", "--plant", NOMINAL,
             "--bundle", bare_bundle, "--out", tmp_path / "better.json"]  # fmt: skip
    assert run(*words) == 2
    error = capsys.readouterr().err
    assert "the test: ends here" in error
    assert error.count(f"warning: {tmp_path}/run.csv: the payload") == warnings


def test_the_goal_map_states_the_mode_of_the_link_beside_a_slow_servo(
    bare_bundle, tmp_path, capsys, monkeypatch
):
    """The loop of the servo has 1.3 rad/s, damped by 0.4: half a period of 2.7 s."""
    monkeypatch.setattr("models.plan.rest_map.PLACES", {1: 7})
    plant, out = tmp_path / "plant.json", tmp_path / "map.json"
    slow = {"position_gain_1_per_s": 6.0, "velocity_gain_1_a_s_rad": 5.0}
    read_plant().with_values(slow).write(plant)
    words = ["goalmap", "--plant", plant, "--bundle", bare_bundle, "--payloads", 0, "--out", out]
    assert run(*words) == 0
    ((half_period_s,),) = (p["half_period_s"] for p in json.loads(out.read_text())["payloads"])
    # With the stiff servo the link's mode is the slowest vibration.
    slowest = next(m for m in modes(read_plant().linearise(0.0)) if m.damping < 0.5)
    assert half_period_s == pytest.approx(slowest.half_period_s, rel=0.05)
    shown = capsys.readouterr()
    assert f"half period {half_period_s:.3f} s" in shown.out
    assert "stands out" not in shown.err
    monkeypatch.setattr(goalmap, "LEAST_SHARE", 0.99)
    assert run(*words) == 0
    assert "with 0 kg no mode of joint 1 stands out" in capsys.readouterr().err


# --- validate -------------------------------------------------------------------------------------


@pytest.fixture
def validate(make_trial, tmp_path, capsys):
    """Function (changes of each trial's columns, options) -> exit code and verdict as JSON."""

    def call(*changes, options=()):
        t = np.concatenate([np.zeros(30), 0.05 * np.arange(100)])
        swinging = np.column_stack([0.5 * np.sin(t), 0.4 * np.sin(1.4 * t)])
        for number, change in enumerate(changes, start=1):
            angle_rad = (1 + 1e-4 * number) * swinging  # no two recordings are alike
            trial = make_trial(
                angle_rad, rest_samples=30, amplitude_rad=0.5, trial=number, name=f"take{number}"
            )
            trial.columns.update(change(trial.columns))
            write_trial(trial, tmp_path)
        code = run("validate", tmp_path, "--json", *options)
        return code, json.loads(capsys.readouterr().out)

    return call


def test_right_trials_pass_with_a_page_each(validate, tmp_path):
    code, verdict = validate(dict, dict, options=("--out", tmp_path / "pages"))
    assert (code, verdict["verdict"]) == (0, "passed"), verdict
    assert (tmp_path / "pages" / "take2.html").read_text().count("<svg") >= 4


@pytest.mark.parametrize(
    ("changes", "code", "verdict", "cause"),
    [
        ((dict, lambda c: {"angle_2_rad": -c["angle_2_rad"]}), 1, "refused", "sign"),
        ((dict,), 0, "warned", "held out"),  # nothing to test on
    ],
    ids=["wrong sign", "single trial"],
)
def test_other_trials_are_refused_or_warned_of_with_the_cause(
    validate, changes, code, verdict, cause
):
    exit_code, result = validate(*changes)
    assert (exit_code, result["verdict"]) == (code, verdict)
    assert result["trials"]["take1"]["verdict"] == "passed"
    last = result["trials"].get("take2", result)
    assert last["findings"][0]["cause"] == cause
