"""Trial files and frames: written and read bit for bit, and refused where a part is wrong."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from firmware_py.core.errors import InputError
from firmware_py.core.motion import KINDS, Motion
from firmware_py.core.signals import trial_signals
from models.plant.document import Provenance
from models.plant.plant import NOMINAL, read_plant
from models.rig.parameters import DEFAULT_STRUCTURE
from models.rig.protocol import RigConditions, TrialCase, record_conditions
from models.trials.checks.trials import read_usable_trials
from models.trials.data_frames import trial_frame, trial_from_frame, trials_frame
from models.trials.files import read_trial, read_trials, write_trial
from models.trials.origin import TrialOrigin, origin_notice, origins_of
from models.trials.trial import SignalRole, Trial, TrialMeta, TrialSet, motion_start
from models.trials.units import base_exponents, check_signal_units
from tests.models.made_trials import with_conditions

finite = st.floats(-6, 6, allow_nan=False)


def edit(path, old, new):
    """Replace a text where it stands first."""
    before = path.read_text()
    assert old in before
    path.write_text(before.replace(old, new, 1))


def set_cell(path, row, column, text):
    """Put `text` into a cell; `row` counts lines of the file from 1, as a refusal does."""
    lines = path.read_text().splitlines()
    cells = lines[row - 1].split(",")
    cells[lines[0].split(",").index(column)] = text
    lines[row - 1] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


def refusal(path):
    with pytest.raises(InputError) as caught:
        read_trial(path)
    sentence = str(caught.value)
    assert str(path.with_suffix("")) in sentence and "\n" not in sentence
    return sentence


@pytest.fixture
def written(make_trial, swing_rad, tmp_path):
    return write_trial(make_trial(swing_rad), tmp_path)


# --- one trial ------------------------------------------------------------------------------------


@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_a_trial_is_read_as_it_was_written_bit_for_bit(make_trial, tmp_path, data):
    dof = data.draw(st.sampled_from([1, 2]))
    trial = make_trial(
        data.draw(arrays(float, (7, dof), elements=finite)),
        data.draw(arrays(float, (7, 16, 3), elements=finite | st.just(np.nan))),
        step_s=data.draw(st.floats(1e-4, 0.5)),
        payload_kg=data.draw(st.floats(0, 2)),
        notes=data.draw(st.text(st.characters(codec="utf-8", exclude_characters="\r"))),
    )
    for k, axis in enumerate("xyz"):
        trial.columns[f"tip_{axis}_m"] = data.draw(arrays(float, 7, elements=finite)) + k
    trial.columns["temperature_1_degc"] = data.draw(
        arrays(float, 7, elements=st.floats(allow_infinity=False))
    )
    back = read_trial(write_trial(trial, tmp_path))
    assert back.meta == trial.meta
    assert list(back.columns) == list(trial.columns)
    for name, column in trial.columns.items():
        assert np.array_equal(back.columns[name], column, equal_nan=True), name
    assert back.sha256() == trial.sha256()


def test_columns_have_the_order_of_the_contract_and_views_their_shapes(written):
    header = written.read_text().splitlines()[0].split(",")
    assert header == [s.name for s in trial_signals(2)]
    trial = read_trial(written)
    n = len(trial)
    assert trial.angle_rad.shape == trial.goal_rad.shape == trial.current_a.shape == (n, 2)
    assert (trial.tip_m.shape, trial.markers_m.shape) == ((n, 3), (n, 16, 3))
    assert trial.markers_m[5, 6, 2] == trial.columns["m07_z_m"][5]
    assert trial.step_s == pytest.approx(0.017)
    assert len(trial.time_s[trial.moving]) == n - 3


@pytest.mark.parametrize(
    ("row", "column", "text", "remedy"),
    [
        (12, "angle_2_rad", "", ""),
        (12, "angle_2_rad", "inf", ""),
        (5, "m01_x_m", "n/a", ""),
        (3, "time_s", "0.0_17", ""),  # a number to Python
        (20, "angle_1_rad", "-30.0", "convert it if it is in deg"),
        (20, "current_1_a", "1250", "convert it if it is in mA"),
        (20, "m03_z_m", "980", "convert it if it is in mm"),
        (7, "time_s", "0.0925", "step"),
        (7, "time_s", "-1.0", "step"),
    ],
)
def test_a_wrong_cell_is_refused_by_row_and_column(written, row, column, text, remedy):
    set_cell(written, row, column, text)
    sentence = refusal(written)
    assert column in sentence and remedy in sentence
    assert f"row {row}" in sentence or f"row {row + 1}, column time_s" in sentence


def test_an_unknown_column_needs_a_unit_unless_it_is_of_a_log(written):
    lines = written.read_text().splitlines()
    written.write_text("\n".join([lines[0] + ",di"] + [row + ",0.01" for row in lines[1:]]))
    assert read_trial(written).columns["di"][4] == 0.01
    edit(written, ",di\n", ",speed\n")
    assert "'speed' has no unit suffix" in refusal(written)


def test_a_damaged_file_is_refused(written):
    whole = written.read_text()
    written.write_text(whole[: len(whole) * 2 // 3].rsplit(",", 1)[0])
    assert f"row {len(written.read_text().splitlines())} has " in refusal(written)
    written.write_text(whole.splitlines()[0] + "\n")
    assert "has 0 rows" in refusal(written)
    written.write_bytes(bytes(range(256)) * 4)
    assert "is not UTF-8 text" in refusal(written)


@pytest.mark.parametrize(
    ("suffix", "old", "new", "words"),
    [
        (".csv", "m16_z_m", "spare_v", "column m16_z_m is missing"),
        (".csv", "angle_1_rad", "angle_1_deg", "to the SI unit and call it angle_1_rad"),
        (".csv", "goal_2_rad", "goal_1_rad", "'goal_1_rad' stands twice"),
        (".toml", "schema = 1", "schema = 2", "schema is 2"),
        (".toml", "schema = 1\n", "", "schema is None"),
        (".toml", "dof = 2", "dof = 3", "dof is 3"),
        (".toml", "payload_kg = 1.0", "payload_kg = nan", "payload_kg is nan"),
        (".toml", "payload_kg", "payload_g", "payload_g"),
        (".toml", "period_s = 4.352", "period_s = 0.0", "period_s is 0.0"),
        (".toml", "amplitude_rad = 0.5", "amplitude_rad = 30", "amplitude_rad is 30"),
        (".toml", "pressure_pa = 41300.0", "pressure_pa = 6.0", "6 PSI are 41370 Pa"),
        (".toml", "rest_samples = 3", "rest_samples = 64", "rest_samples is 64"),
        (".toml", "rest_samples = 3", "rest_samples == 3", "is not TOML"),
        (".toml", 'motion = "sinusoid"', 'motion = "Sinusoid"', 'write motion = "sinusoid"'),
    ],
)
def test_a_wrong_name_or_condition_is_refused_by_its_file(written, suffix, old, new, words):
    edit(written.with_suffix(suffix), old, new)
    sentence = refusal(written)
    assert words in sentence and suffix in sentence


def test_times_in_milliseconds_are_refused_for_the_link_alone(make_trial, swing_rad, tmp_path):
    path = write_trial(make_trial(swing_rad, step_s=17.0), tmp_path)
    assert "the rows are 17 s apart" in refusal(path)
    meta = TrialMeta(
        dof=1, payload_kg=0.0, trial=1, motion="Steps", source="measured", period_s=0.0,
        rest_samples=1,
    )  # fmt: skip
    columns = {"time_s": 60.0 * np.arange(4), "temperature_1_degc": np.zeros(4)}
    path = write_trial(Trial("oven", meta, columns), tmp_path)
    assert len(read_trial(path, {"temperature_1_degc": SignalRole("degC", "measured")})) == 4


def test_the_tip_is_empty_only_without_motion_capture(make_trial, swing_rad, tmp_path):
    trial = make_trial(swing_rad)
    for name in trial.columns:
        if name.startswith(("tip", "m0", "m1")):
            trial.columns[name][:] = np.nan
    back = read_trial(write_trial(trial, tmp_path))
    assert np.isnan(back.tip_m).all() and np.isnan(back.markers_m).all()
    trial.columns["tip_x_m"][7:] = 0.1
    assert "row 2, column 'tip_x_m'" in refusal(write_trial(trial, tmp_path))


def test_a_full_disk_leaves_the_earlier_trial(make_trial, swing_rad, tmp_path, monkeypatch):
    trial = make_trial(swing_rad)
    write_trial(trial, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def refused(path, *_, **__):
        path.open("w").close()  # the old content is gone
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for method in ("write_bytes", "write_text"):
        monkeypatch.setattr(Path, method, refused)
    other = with_conditions(trial, trial=7)
    with pytest.raises(OSError, match="No space left"):
        write_trial(other, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


# --- directories and sets -------------------------------------------------------------------------


@pytest.fixture
def directory(make_trial, swing_rad, tmp_path):
    for name in ("second", "first"):
        write_trial(make_trial(swing_rad, name=name), tmp_path)
    return tmp_path


def test_missing_files_and_directories_are_named(written, tmp_path):
    assert "is missing" in refusal(tmp_path / "none.csv")
    written.with_suffix(".toml").unlink()
    assert "run.toml: is missing" in refusal(written)
    (tmp_path / "empty").mkdir()
    for name, words in (("none", "is not a directory"), ("empty", "holds no trial")):
        with pytest.raises(InputError, match=words):
            read_trials(tmp_path / name)


@pytest.mark.parametrize("suffix", [".CSV", ".Toml"])
def test_a_suffix_may_be_in_capitals(directory, suffix):
    before = read_trials(directory)
    (directory / f"first{suffix.lower()}").rename(directory / f"first{suffix}")
    after = read_trials(directory)
    assert [t.name for t in after] == ["first", "second"]
    assert after.sha256() == before.sha256()


def test_conditions_without_samples_and_two_files_of_one_name_are_refused(directory):
    copy = directory / "first.CSV"
    if not copy.exists():  # the file system distinguishes the case
        copy.write_bytes((directory / "first.csv").read_bytes())
        with pytest.raises(InputError, match="has the name of the trial first"):
            read_trials(directory)
        copy.unlink()
    (directory / "first.csv").unlink()
    with pytest.raises(InputError, match=r"first\.toml: .*first\.csv is"):
        read_trials(directory)


def test_other_documents_may_lie_beside_trials(directory):
    for name, content in {
        "map": "[trial]\ntrial = 1\nrest_samples = 3\nmotion = 'step'\n[columns]\n",
        "link": "name = 'link'\nmotion = 'none'\n", "damaged": "trial = ", "empty": "",
    }.items():  # fmt: skip
        (directory / f"{name}.toml").write_text(content)
    assert [t.name for t in read_trials(directory)] == ["first", "second"]


def test_of_several_directories_names_differ_and_a_copy_is_refused(make_trial, tmp_path):
    places = [tmp_path / "first", tmp_path / "second"]
    swing_rad = 0.5 * np.sin(0.05 * np.arange(200))
    for place, factor in zip(places, (1.0, 1.01), strict=True):
        trial = make_trial(swing_rad, rest_samples=0)
        trial.columns["goal_1_rad"] = factor * swing_rad
        write_trial(trial, place)
    first, second = (t.name for t in read_usable_trials(places, {}))
    assert first.startswith("first_") and second == first.replace("first", "second")
    write_trial(trial, places[0])
    with pytest.raises(InputError, match="is a copy of"):
        read_usable_trials(places, {})


def test_repetitions_and_smaller_amplitudes_are_held_out(make_trial, swing_rad):
    conditions = {
        "one": {"payload_kg": 0.0, "trial": 2},
        "one_again": {"payload_kg": 0.0, "trial": 3},
        "small": {"payload_kg": 0.0, "amplitude_rad": 0.5136},
        "rounded": {"payload_kg": 1.0, "amplitude_rad": 0.5236},
        "ahead": {"payload_kg": 1.0, "phase_2_rad": 1.57, "trial": 4},
        "ahead_again": {"payload_kg": 1.0, "phase_2_rad": 1.57, "trial": 5},
        "other_motion": {"motion": "triangle", "amplitude_rad": 0.1},
    }
    trials = TrialSet(tuple(
        make_trial(swing_rad, name=name, **{"amplitude_rad": 0.5235987755982988} | changed)
        for name, changed in conditions.items()
    ))  # fmt: skip
    fitted, held_out = trials.split()
    assert [t.name for t in fitted] == ["one", "rounded", "ahead", "other_motion"]
    assert [t.name for t in held_out] == ["one_again", "small", "ahead_again"]


# --- start of the motion --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("dof", "phase_rad", "period_s", "resolution_rad"),
    [(1, 0.0, 1.0, 0.0), (2, np.pi / 2, 20.0, 2 * np.pi / 4096)],
)
def test_the_start_is_fitted_to_the_goals(
    kind, dof, phase_rad, period_s, resolution_rad, make_trial
):
    motion = Motion(kind, dof=dof, period_s=period_s, phase_2_rad=phase_rad)
    rows = np.arange(37 + round(motion.duration_s / 0.017)) - 37
    goals = motion.goal_rad(rows * 0.017)
    if resolution_rad:
        goals = np.round(goals / resolution_rad) * resolution_rad
    conditions = {
        "motion": kind, "period_s": period_s, "phase_2_rad": phase_rad, "rest_samples": 30,
        "amplitude_rad": motion.amplitude_rad,
    }  # fmt: skip
    assert motion_start(make_trial(goals, **conditions)) == 37
    assert motion_start(make_trial(-goals, **conditions)) == 37
    for other in ({"motion": "wave"}, {"period_s": 0.7 * period_s}, {"amplitude_rad": 0.3}):
        assert motion_start(make_trial(goals, **conditions | other)) == 30


# --- data frames ----------------------------------------------------------------------------------


@pytest.fixture
def trial(toy_trials):
    toy = toy_trials(1, amplitudes_deg=(30,), trials=(1,), payloads_kg=(1.0,))[0]
    toy.columns["m03_x_m"][5:8] = np.nan
    return toy


def test_a_trial_comes_back_from_its_frame(trial):
    frame = trial_frame(trial)
    back = trial_from_frame(frame)
    assert (back.name, back.meta, back.sha256()) == (trial.name, trial.meta, trial.sha256())
    half = trial_from_frame(frame[: len(frame) // 2], name="half")
    assert len(half) == len(trial) // 2 and half.meta == trial.meta


def test_trials_stand_below_each_other(toy_trials):
    trials = toy_trials(1, amplitudes_deg=(30,), trials=(1, 2), payloads_kg=(0.0, 2.0))
    frame = trials_frame(trials)
    assert list(frame.groupby("name").size()) == [len(t) for t in trials]
    means = frame.groupby("payload_kg")["current_1_a"].std()
    assert means[2.0] > means[0.0]  # more weight, more current
    with pytest.raises(InputError):
        trials_frame([])


FRAME_FAULTS = {
    "convert it if it is in degrees": lambda f: f.assign(angle_1_rad=np.degrees(f["angle_1_rad"])),
    "row 5, column 'current_1_a'": lambda f: f.assign(
        current_1_a=f["current_1_a"].where(f.index != 3)
    ),
    "resample": lambda f: f.assign(time_s=f["time_s"] + 0.005 * (f.index == 7)),
    "at least three": lambda f: f[:2],
}


@pytest.mark.parametrize("message", FRAME_FAULTS)
def test_a_frame_that_is_no_trial_is_refused(trial, message):
    frame = trial_frame(trial)
    with pytest.raises(InputError, match=message):
        trial_from_frame(FRAME_FAULTS[message](frame), trial.name, trial.meta)


def test_a_frame_without_name_or_conditions_is_refused(trial):
    frame = trial_frame(trial)
    for attrs, message in (({"name": "x"}, "TrialMeta"), ({}, "name")):
        frame.attrs = attrs
        with pytest.raises(InputError, match=message):
            trial_from_frame(frame)


def test_a_frame_of_another_plant_needs_its_signals():
    plant = read_plant(NOMINAL.parent / "examples" / "emps.toml")
    meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="rest", source="measured",
                     period_s=1.0, rest_samples=1)  # fmt: skip
    columns = {"time_s": np.arange(5) * 1e-3, "position_1_m": np.zeros(5)}
    columns |= {n: np.zeros(5) for n, s in plant.signals.items() if s.role == "goal"}
    frame = trial_frame(Trial("rest", meta, columns))
    assert trial_from_frame(frame, signals=plant.signals).meta == meta
    with pytest.raises(InputError, match="pressure_pa is missing"):
        trial_from_frame(frame)


# --- origin ---------------------------------------------------------------------------------------

RIG, MEASURED = TrialOrigin("rig", "default", 4), TrialOrigin("measured", trials=2)


@pytest.mark.parametrize(
    ("origins", "kind"),
    [
        ([RIG, TrialOrigin("sil", "twin"), TrialOrigin("simulated")], "simulated"),
        ([MEASURED, TrialOrigin("recording")], "measured"),
        ([RIG, MEASURED, TrialOrigin("")], "mixed"),
        ([RIG, TrialOrigin("")], "unknown"),
    ],
)
def test_simulated_trials_never_pass_for_measured_ones(origins, kind):
    notice = origin_notice(origins)
    assert notice.kind == kind
    assert ("measured" in notice.label.lower()) is (kind in ("measured", "mixed"))
    assert ("No robot was measured" in notice.text) is (kind == "simulated")
    assert all(o.words in notice.text for o in origins)


def test_the_rig_is_read_from_the_record_beside_a_trial(make_trial, tmp_path):
    trial = make_trial([0.0, 0.1, 0.2, 0.3, 0.4], source="rig", rest_samples=2)
    again = read_trial(write_trial(trial, tmp_path))
    assert origins_of([again, trial]) == (TrialOrigin("rig", trials=2),)  # no record: not known
    conditions = RigConditions(
        seed=1, hidden={"backlash": 0.1}, rig_sha256="", rig="drawn_3", structure=DEFAULT_STRUCTURE
    )
    case = TrialCase(Motion(), 0.0, 1)
    record_conditions([case], conditions, tmp_path)
    named = replace(again, name=case.name)
    assert origins_of([named, named]) == (TrialOrigin("rig", "drawn_3", 2),)
    fitted = Provenance().fitted_with([named])
    assert Provenance(fitted_trials=fitted).origins == (TrialOrigin("rig", "drawn_3"),)
    assert "backlash" not in repr(origins_of([named]))  # what is hidden stays hidden
    measured = with_conditions(named, source="measured")
    assert origins_of([measured]) == (TrialOrigin("measured"),)
    for damaged in ("{", "[]", '{"trials": {"' + case.name + '": 1}}'):
        (tmp_path / "rig_conditions.json").write_text(damaged)
        assert origins_of([named]) == (TrialOrigin("rig"),)


# --- units of signals -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("1", {}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("rad/(N.m)", {"rad": 1, "kg": -1, "m": -2, "s": 2}),
        ("m/s2", {"m": 1, "s": -2}),
        ("V", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("N/(N/(m.s))", {"m": 1, "s": 1}),
    ],
)
def test_units_are_powers_of_base_units(unit, exponents):
    assert base_exponents(unit) == exponents
    for misspelt in (unit + "furlong", unit + "..m", "(" + unit, unit + ")m", unit + " s"):
        with pytest.raises(ValueError, match="is not a unit"):
            base_exponents(misspelt)


@pytest.mark.parametrize(
    ("name", "signal", "words"),
    [
        ("encoder", ("mm", "measured", "position_1_m"), "its quantity position_1_m in 'm'"),
        ("position_1_m", ("mm", "measured"), "its name says 'm'"),
        ("moved", ("g", "condition", "load_mass_1_kg"), "give 'kg'"),
        ("x", ("Nm", "goal"), "no SI unit"),
        ("x", ("deg", "measured"), "no SI unit"),
        ("x", ("N.mm/rad", "condition"), "no SI unit"),
    ],
)
def test_a_signal_in_another_unit_is_refused(name, signal, words):
    with pytest.raises(InputError) as refused:
        check_signal_units(Path("car.toml"), {name: SignalRole(*signal)})
    assert f"car.toml: signal {name} is in {signal[0]!r}" in str(refused.value)
    assert words in str(refused.value)
