"""What a map leaves to the link, and the takes that one map imports."""

import pytest

from firmware_py.core.errors import InputError
from firmware_py.link.link_description import LinkDescription, link_toml
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
        ("step_s = 1e-9\n", "", "", r"map\.toml: step_s"),
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
     ("{motion}_take{trial}x", "does not fit"), ("load{trial}_{motion}", "no number"),
     ("load{trial}_take{trial}", "names a condition twice"), ("load", "does not fit"),
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
    with pytest.raises(InputError, match=r"a trial of the same name as .*run\.csv; rename"):
        find_takes(files, "table", RecordingMap())


def test_a_take_that_is_named_twice_and_a_folder_without_takes_are_refused(tmp_path):
    (tmp_path / "run.csv").write_text("x")
    with pytest.raises(InputError, match="is given twice; name each recording once"):
        find_takes([tmp_path, tmp_path / "run.csv"], "table", RecordingMap())
    with pytest.raises(InputError, match="holds no take"):
        find_takes([tmp_path], "c3d", RecordingMap())
