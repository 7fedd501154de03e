"""Maps: what they leave to the link, the takes that one imports, and imports over earlier ones."""

import re
from pathlib import Path

import numpy as np
import pytest

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.link.link_description import LinkDescription
from models.commands.new import link_toml
from models.trials.files import read_trial
from models.trials.pipeline import recording_hash
from models.trials.recordings.mapping import RecordingMap, TakeRules, find_takes, read_mapping
from tests.models.trials.recordings.written_takes import WrittenTake, rigid_trial

TRIAL = """
[trial]
payload_kg = 0.1
trial = 1
motion = "sinusoid"
period_s = 4.352
amplitude_rad = 0.5236
"""


def mapping(directory, joints, text):
    link = LinkDescription(length_m=0.6, width_m=0.1, joints=joints)
    (directory / "link.toml").write_text(link_toml(link, 1.0, 1.0), encoding="utf-8")
    (directory / "map.toml").write_text(text, encoding="utf-8")
    return read_mapping(directory / "map.toml")


@pytest.mark.parametrize(("joints", "dof", "more"), [(1, 1, ""), (2, 2, ""), (2, 1, "dof = 1\n")])
def test_size_and_joints_are_those_of_the_link_unless_the_map_states_them(
    tmp_path, joints, dof, more
):
    read = mapping(tmp_path, joints, 'link = "link.toml"\n' + TRIAL + more)
    meta = read.meta(rest_samples=20)
    assert (meta.dof, read.dof, meta.link_length_m) == (dof, dof, 0.6)


@pytest.mark.parametrize(
    ("head", "old", "new", "words"),
    [
        ("step_s = 17\n", "", "", r"map\.toml: step_s"),
        ("colour = 'blue'\n", "", "", "colour"),
        ("step_named = true\n", "", "", "step_named"),
        ("", "0.1", "'heavy'", "payload_kg"),
        ("", "\n[trial]", "\n[markers]\nm17 = 'x'\n[trial]", "'m17' is no marker"),
        ("", "4.352", "0.0", r"map\.toml: period_s is 0\.0"),
        ("joints = ['a', 'a']\n", "", "", "takes joint 1 and joint 2 both from 'a'"),
        ("", "\n[trial]", "\n[markers]\nm01 = 'x'\nm02 = 'x'\n[trial]", "takes m01 and m02 both"),
    ],
)
def test_a_wrong_value_is_a_fault_of_the_map(tmp_path, head, old, new, words):
    text = f'{head}link = "link.toml"\n' + TRIAL.replace(old, new)
    with pytest.raises(InputError, match=words):
        mapping(tmp_path, 1, text).meta(20)


@pytest.fixture
def folder(tmp_path):
    for name in ("load0.5_take1", "load1_take2"):
        (tmp_path / f"{name}.csv").write_text("x")
        (tmp_path / f"{name}_servo.csv").write_text("x")
    return tmp_path


def test_conditions_come_from_the_names(folder):
    rules = TakeRules(pattern="load{payload_kg}_take{trial}", servo="{name}_servo.csv")
    takes = find_takes([folder], "motive", RecordingMap(takes=rules, trial={"dof": 1}))
    assert [t.file.name for t in takes] == ["load0.5_take1.csv", "load1_take2.csv"]
    assert [t.mapping.trial for t in takes] == [
        {"dof": 1, "payload_kg": 0.5, "trial": 1},
        {"dof": 1, "payload_kg": 1.0, "trial": 2},
    ]
    assert [t.servo.name for t in takes] == ["load0.5_take1_servo.csv", "load1_take2_servo.csv"]


def table_map(folder, text):
    (folder / "takes.csv").write_text(text)
    return RecordingMap(takes=TakeRules(table="takes.csv"), path=str(folder / "map.toml"))


def test_conditions_come_from_a_table(folder):
    mapping = table_map(
        folder, "file,payload_kg,trial,servo,offset_s\nload0.5_take1,0.5,3,a.mcap,1.5\n"
    )
    (take,) = find_takes([folder], "motive", mapping)
    assert take.mapping.trial == {"payload_kg": 0.5, "trial": 3}
    assert (take.servo, take.offset_s) == (folder / "a.mcap", 1.5)
    with pytest.raises(InputError, match="has no row for load1_take2"):
        find_takes([folder / "load1_take2.csv"], "motive", mapping)


@pytest.mark.parametrize(
    ("pattern", "what"),
    [("run{trial}", "does not fit"), ("load{mass}_take{trial}", "is no condition"),
     ("load{trial}_{motion}", "no number"), ("load{trial}_take{trial}", "names a condition twice"),
     ("load0.5_take1{notes}", "does not fit")],
)  # fmt: skip
def test_a_wrong_pattern_is_refused(tmp_path, pattern, what):
    mapping = RecordingMap(takes=TakeRules(pattern=pattern))
    with pytest.raises(InputError, match=what):
        find_takes([tmp_path / "load0.5_take1.csv"], "motive", mapping)


def test_a_name_that_fits_in_many_ways_is_refused_at_once(tmp_path):
    pattern = "{notes}{motion}{source}{trial}{dof}{rest_samples}{payload_kg}x"
    mapping = RecordingMap(takes=TakeRules(pattern=pattern))
    with pytest.raises(InputError, match="does not fit"):
        find_takes([tmp_path / ("1" * 200)], "motive", mapping)


@pytest.mark.parametrize(
    ("table", "what"),
    [("file,trial,trial\na,1,2\n", "column 'trial' stands twice"),
     ("file,trial\na,1\na,2\n", "take 'a' stands twice"),
     ("file,trial\na,1,2\n", "row 2 has 3 cells, the header 2"),
     ("file,offset_s\na,soon\n", "offset_s is 'soon'"), ("file,offset_s\na,inf\n", "'inf'"),
     ("file,mass\na,1\n", "'mass' is no condition"), ("", "has no column 'file'"),
     ("file\n", "with a row"), ("file\n" + "a\n" * 10**6, "MB")],
)  # fmt: skip
def test_a_wrong_table_is_refused(tmp_path, table, what):
    with pytest.raises(InputError, match=what):
        find_takes([tmp_path / "a"], "motive", table_map(tmp_path, table))


@pytest.mark.parametrize("other", ["run.tsv", "RUN.csv", "deeper/run.csv"])
def test_two_takes_of_one_name_are_refused(tmp_path, other):
    (tmp_path / "deeper").mkdir()
    files = [tmp_path / "run.csv", tmp_path / other]
    with pytest.raises(InputError, match=r"same name as .*run\.csv"):
        find_takes(files, "table", RecordingMap())


def test_a_folder_holds_tables_and_marker_exports(tmp_path):
    names = ["a.csv", "b.tsv", "c.TRC", "d.json", "e.mat"]
    for name in [*names, "notes.txt"]:
        (tmp_path / name).write_text("x")
    takes = find_takes([tmp_path], "table", RecordingMap())
    assert [take.file.name for take in takes] == names


def test_a_take_that_is_named_twice_and_a_folder_without_takes_are_refused(tmp_path):
    (tmp_path / "run.csv").write_text("x")
    with pytest.raises(InputError, match="name each recording once"):
        find_takes([tmp_path, tmp_path / "run.csv"], "table", RecordingMap())
    with pytest.raises(InputError, match="holds no take"):
        find_takes([tmp_path], "c3d", RecordingMap())


# --- imports over earlier ones --------------------------------------------------------------------


@pytest.fixture
def importing(servo_csv, write_map, tmp_path, capsys):
    """Function (files, number of the trial, map, directory, options) -> exit code and error."""

    def call(*files, trial=1, mapping=None, out="out", options=()):
        mapping = mapping or write_map(columns=servo_csv[1], trial={"trial": trial})
        arguments = ["--as", "table", "--map", str(mapping), "--out", str(tmp_path / out)]
        code = main(["import", *map(str, files), *arguments, *options])
        return code, capsys.readouterr().err

    return call


@pytest.fixture
def record(servo_csv):
    """Function (path, blank lines at its end) -> a recording; other lines make it another one."""

    def write(path, blank=0):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(servo_csv[0].read_bytes() + blank * b"\n")
        return path

    return write


def contents(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_a_recording_is_imported_again_with_another_map_and_from_another_place(
    tmp_path, importing, record
):
    assert importing(record(tmp_path / "take.csv"))[0] == 0
    moved = record(tmp_path / "moved" / "take.csv")
    assert importing(moved, trial=2)[0] == 0
    meta = read_trial(tmp_path / "out" / "take.csv").meta
    assert (meta.trial, meta.recording_sha256) == (2, recording_hash(moved))


@pytest.mark.parametrize("capitals", [False, True])
def test_a_trial_of_another_recording_stays(capitals, tmp_path, importing, record):
    assert importing(record(tmp_path / "takes" / "take.csv"))[0] == 0
    for path in (tmp_path / "out").glob("take.*" if capitals else "none"):
        path.rename(path.with_suffix(path.suffix.upper()))
    before = contents(tmp_path / "out")
    take = record(tmp_path / "takes" / "take.csv", blank=1)
    code, err = importing(take)
    assert code == 2
    assert f"take.{'CSV' if capitals else 'csv'}: is a trial of another recording" in err
    record(tmp_path / "takes" / "other.csv", blank=2)
    assert importing(tmp_path / "takes")[0] == 2  # the other take is imported
    after = contents(tmp_path / "out")
    assert "other.csv" in after and {name: after[name] for name in before} == before
    assert importing(take, options=["--name", "second"])[0] == 0


@pytest.mark.parametrize("name", ["take.csv", "take.toml"])
def test_a_file_that_is_no_imported_trial_stays(tmp_path, importing, record, name):
    file = record(tmp_path / "take.csv")
    assert importing(file)[0] == 0
    for path in (tmp_path / "out").iterdir():
        if path.name == name:
            path.write_text(path.read_text().split("recording_sha256")[0])
        else:
            path.unlink()
    before = contents(tmp_path / "out")
    code, err = importing(file)
    assert code == 2 and f"{name}: would be replaced" in err
    assert contents(tmp_path / "out") == before


def test_a_file_that_is_read_stays(tmp_path, importing, record, write_map, servo_csv):
    file = record(tmp_path / "raw" / "run.csv")
    (file.parent / "take.csv").symlink_to(file)
    mapping = write_map(columns=servo_csv[1]).rename(file.parent / "other.toml")
    before = contents(tmp_path / "raw")
    for name, read in (("take", "take.csv"), ("run", "run.csv"), ("other", "other.toml")):
        code, err = importing(file, mapping=mapping, out="raw", options=["--name", name])
        assert code == 2 and "would replace" in err and f"{read}, which is read" in err
        assert contents(tmp_path / "raw") == before


def test_the_hash_of_a_bag_follows_its_files(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("a")
    first = recording_hash(bag)
    moved = bag.rename(tmp_path / "moved")
    assert recording_hash(moved) == first
    (moved / "metadata.yaml").write_text("c")
    assert recording_hash(moved) != first


# --- the guide's examples -------------------------------------------------------------------------

GUIDE = Path("docs/trials.md").read_text(encoding="utf-8")
_, *MAPS = re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL)
CONDITIONS = re.search(r"^\[trial\]\n.*?\n(?=\n)", MAPS[0], re.MULTILINE | re.DOTALL)[0]
"""Table of conditions in the first map, which the others say to have too."""


@pytest.mark.parametrize("text", MAPS, ids=["motive", "table", "rosbag"])
def test_every_map_of_the_guide_is_one(text, tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(text if text.startswith("[trial]\n") else text + CONDITIONS, encoding="utf-8")
    read = read_mapping(path)
    assert read.meta(rest_samples=60).dof == read.dof
    assert read.columns or read.servo_columns or read.topics


def test_the_map_of_motive_and_a_servo_imports_a_take_as_printed(rigid_markers, run, tmp_path):
    """The clock of the servo is ahead of the capture's, whose frame lies elsewhere with y up."""
    time_s = 0.017 * np.arange(600)
    swing = -0.5236 * np.sin(2 * np.pi / 4.352 * np.clip(time_s - 1.02, 0, 2 * 4.352))
    take = WrittenTake(offset_s=-3.2, base="plate")
    take.write(rigid_trial(swing[:, None]), tmp_path, 1)
    servo = (tmp_path / "servo.csv").read_text().replace("goal1;pos1;cur1", "goal;position;current")
    (tmp_path / "servo.csv").write_text(servo)
    (tmp_path / "map.toml").write_text(MAPS[0], encoding="utf-8")
    code, out, err = run(
        tmp_path / "take.csv", "--as", "motive", "--servo", tmp_path / "servo.csv",
        "--map", tmp_path / "map.toml",
    )  # fmt: skip
    assert code == 0, err
    assert "-3.200" in out and "no warnings" in out, err
    trial = read_trial(tmp_path / "trials" / "take.csv")
    rigid_m = rigid_markers(np.pad(trial.angle_rad, ((0, 0), (0, 1))))
    assert np.abs(trial.markers_m - rigid_m).max() < 2e-3
