"""What a map leaves to the link, and the takes that one map imports."""

import pytest

from firmware_py.errors import InputError
from firmware_py.link.link_description import LinkDescription
from firmware_py.link.link_file import link_toml
from models.trials.recordings.mapping import RecordingMap, TakeRules, find_takes, read_mapping

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


@pytest.mark.parametrize("joints", [1, 2])
def test_the_joints_are_those_of_the_link_where_the_map_gives_none(tmp_path, joints):
    given = mapping(tmp_path, joints, 'link = "link.toml"\n' + TRIAL)
    meta = given.meta(rest_samples=20)
    assert (meta.dof, given.dof, meta.link_length_m) == (joints, joints, 0.6)


def test_the_maps_own_joints_count_more_than_the_links(tmp_path):
    meta = mapping(tmp_path, 2, 'link = "link.toml"\n' + TRIAL + "dof = 1\n").meta(20)
    assert meta.dof == 1


@pytest.mark.parametrize("step_s", ["17", "0.0", "1e-9"])
def test_a_step_of_another_unit_is_refused(tmp_path, step_s):
    with pytest.raises(InputError, match=r"map\.toml: step_s"):
        mapping(tmp_path, 1, f'step_s = {step_s}\nlink = "link.toml"\n' + TRIAL)


def test_a_period_of_zero_is_a_fault_of_the_map(tmp_path):
    text = 'link = "link.toml"\n' + TRIAL.replace("4.352", "0.0")
    with pytest.raises(InputError, match=r"map\.toml: period_s is 0\.0"):
        mapping(tmp_path, 1, text).meta(20)


@pytest.fixture
def folder(tmp_path):
    for name in ("load0.5_take1.csv", "load1_take2.csv", "load1_take2_servo.csv"):
        (tmp_path / name).write_text("x")
    (tmp_path / "load0.5_take1_servo.csv").write_text("x")
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


def test_conditions_come_from_a_table(folder):
    (folder / "takes.csv").write_text(
        "file,payload_kg,trial,servo,offset_s\nload0.5_take1,0.5,3,a.mcap,1.5\n"
    )
    rules = TakeRules(table="takes.csv")
    mapping = RecordingMap(takes=rules, path=str(folder / "map.toml"))
    (take,) = find_takes([folder], "motive", mapping)
    assert take.mapping.trial == {"payload_kg": 0.5, "trial": 3}
    assert (take.servo, take.offset_s) == (folder / "a.mcap", 1.5)
    with pytest.raises(InputError, match="has no row for load1_take2"):
        find_takes([folder / "load1_take2.csv"], "motive", mapping)


@pytest.mark.parametrize(
    ("pattern", "what"),
    [("run{trial}", "does not fit"), ("load{mass}_take{trial}", "is no condition"),
     ("load{gravity_m_s2}_take{trial}", "is no condition"),
     ("{motion}_take{trial}x", "does not fit"), ("load{trial}_{motion}", "no number"),
     ("load{trial}_take{trial}", "names a condition twice"), ("load", "does not fit"),
     ("load0.5_take1{notes}", "does not fit")],
)  # fmt: skip
def test_a_wrong_pattern_is_refused_in_one_sentence(folder, pattern, what):
    with pytest.raises(InputError, match=what):
        find_takes(
            [folder / "load0.5_take1.csv"], "motive", RecordingMap(takes=TakeRules(pattern=pattern))
        )


def test_a_name_that_fits_in_many_ways_is_taken_apart_at_once(tmp_path):
    names = ("notes", "motion", "source", "trial", "dof", "rest_samples", "payload_kg")
    pattern = "".join(f"{{{name}}}" for name in names) + "x"
    file = tmp_path / ("1" * 200)
    with pytest.raises(InputError, match="does not fit"):
        find_takes([file], "motive", RecordingMap(takes=TakeRules(pattern=pattern)))


@pytest.mark.parametrize(
    ("table", "what"),
    [("file,trial,trial\na,1,2\n", "column 'trial' stands twice"),
     ("file,trial\na,1\na,2\n", "take 'a' stands twice"),
     ("file,trial\na,1,2\n", "row 2 has 3 cells, the header 2"),
     ("file,offset_s\na,soon\n", "offset_s is 'soon'"), ("file,offset_s\na,inf\n", "'inf'"),
     ("", "has no column 'file'"), ("file\n", "with a row"), ("file\n" + "a\n" * 10**6, "MB")],
)  # fmt: skip
def test_a_wrong_table_is_refused_in_one_sentence(tmp_path, table, what):
    (tmp_path / "takes.csv").write_text(table)
    mapping = RecordingMap(takes=TakeRules(table="takes.csv"), path=str(tmp_path / "map.toml"))
    with pytest.raises(InputError, match=what):
        find_takes([tmp_path / "a"], "motive", mapping)


def test_only_the_name_stands_for_something_in_the_name_of_a_servo_file(folder):
    rules = TakeRules(servo="{name}_{x:>999999999}.csv")
    (take,) = find_takes([folder / "load1_take2.csv"], "motive", RecordingMap(takes=rules))
    assert take.servo.name == "load1_take2_{x:>999999999}.csv"


@pytest.mark.parametrize("other", ["run.tsv", "RUN.csv", "deeper/run.csv"])
def test_two_takes_of_one_name_are_refused(tmp_path, other):
    (tmp_path / "deeper").mkdir()
    files = [tmp_path / "run.csv", tmp_path / other]
    with pytest.raises(InputError, match=r"a trial of the same name as .*run\.csv; rename"):
        find_takes(files, "table", RecordingMap())


def test_a_take_that_is_given_twice_is_refused(tmp_path):
    (tmp_path / "run.csv").write_text("x")
    with pytest.raises(InputError, match="is given twice; name each recording once"):
        find_takes([tmp_path, tmp_path / "run.csv"], "table", RecordingMap())


def test_a_folder_without_takes_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no take"):
        find_takes([tmp_path], "c3d", RecordingMap())
