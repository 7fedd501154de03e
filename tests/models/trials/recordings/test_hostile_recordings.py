"""Damaged and hostile recordings end in one sentence, within limits of memory and time."""

import json
import os
import sqlite3
import struct
import zlib

import lz4.frame
import pytest
import zstandard

from dropstitch.__main__ import main
from firmware_py.core.errors import InputError
from firmware_py.log import recording
from firmware_py.log.recording import read_recording
from tests.fuzz import valid_files
from tests.fuzz.readers import written_log

COLUMNS, MAP = valid_files.table()
CSV = valid_files.csv_of(COLUMNS)
CHUNK = 6


@pytest.fixture
def sentence(tmp_path, capsys):
    """Import a file or a directory that is refused; returns the sentence."""

    def sentence(name, content=None, kind="table", map_=MAP, more=()):
        file = tmp_path / name
        if content is not None:
            file.write_bytes(content)
        (tmp_path / "map.toml").write_bytes(map_)
        argv = [str(file), "--as", kind, "--map", str(tmp_path / "map.toml"), *more]
        assert main(["import", *argv, "--out", str(tmp_path / "out")]) == 2
        printed = capsys.readouterr().err
        assert printed.startswith("dropstitch: ") and printed.count("\n") == 1, printed
        assert not list((tmp_path / "out").glob(".*")), "no temporary files remain"
        return printed

    return sentence


@pytest.mark.parametrize(
    ("key", "value", "what"),
    [
        ("dof", "1000000000", "is not a log of dropstitch"),
        ("config", '{"a":' * 5000, "its metadata are damaged: config"),
        ("payload_kg", "heavy", "its metadata are damaged: payload_kg"),
        ("period_s", "0", "its metadata are damaged: period_s"),
    ],
)
def test_metadata_of_a_log_are_checked(sentence, key, value, what):
    _, metadata, messages = valid_files.log()
    log = written_log(metadata | {key: value}, messages)
    assert what in sentence("a.mcap", log, "recording")


def test_text_in_a_tick_ends_the_log_there(tmp_path):
    _, metadata, messages = valid_files.log()
    messages[5] = messages[5].replace(b'"state":0', b'"state":"high"')
    path = tmp_path / "a.mcap"
    path.write_bytes(written_log(metadata, messages))
    log = read_recording(path)
    assert len(log.columns["tick"]) == 5 and not log.complete


def test_a_chunk_that_unpacks_to_much_is_not_unpacked(tmp_path):
    data, *_ = valid_files.log()
    unknown = (b"\x80" + bytes(8)) * 2_000_000  # records of nothing: 18 MB in 70 kB
    packed = lz4.frame.compress(unknown)
    chunk = struct.pack("<QQQII", 0, 0, len(unknown), 0, 3) + b"lz4"
    chunk += struct.pack("<Q", len(packed)) + packed
    at = 8  # behind the magic bytes: records of opcode, length, content
    while data[at] != CHUNK:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    path = tmp_path / "a.mcap"
    path.write_bytes(data[:at] + b"\x06" + struct.pack("<Q", len(chunk)) + chunk + data[at:])
    with pytest.raises(InputError, match="no whole chunk"):
        read_recording(path)


def test_a_log_of_too_many_ticks_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "MOST_TICKS", 10)
    path = tmp_path / "a.mcap"
    path.write_bytes(valid_files.log()[0])
    with pytest.raises(InputError, match="holds more than 10 ticks"):
        read_recording(path)


def test_one_late_time_stamp_does_not_make_a_trial_of_years(sentence):
    lines = CSV.split("\n")
    lines[-1] = "1e12" + lines[-1][lines[-1].index(",") :]
    assert "has no samples for" in sentence("a.csv", "\n".join(lines).encode())


def test_two_columns_of_one_name_are_refused(sentence):
    lines = [f"{line},{line.split(',')[1]}" for line in CSV.split("\n")]
    assert "column 'pos' stands twice" in sentence("a.csv", "\n".join(lines).encode())
    rows = json.dumps([dict.fromkeys(COLUMNS, 1.0)] * 3)
    doubled = rows.replace('"pos"', '"pos": 2, "pos"')
    assert "'pos' stands twice" in sentence("a.json", doubled.encode())


def test_a_damaged_header_takes_no_memory(sentence):
    head = valid_files.motive().split(b"\n")[0]
    assert "no row that begins with Frame" in sentence("a.csv", head + b"\n" * 1_000_000, "motive")
    data = bytearray(valid_files.c3d())
    data[2:12] = b"\xff" * 10  # points, analog channels, first and last frame
    for at in (i for i in range(512, 2048) if data[i : i + 4] == b"USED"):
        data[at + 8 : at + 12] = b"\xff\x7f\xff\x7f"
    sentence("a.c3d", bytes(data), "c3d")


@pytest.mark.parametrize(("at", "value"), [(8, 0x7FFFFFFF), (56, 2**32 - 1)])
def test_a_damaged_matlab_file_is_refused_or_ends_its_child(sentence, at, value):
    data = valid_files.matlab_of(COLUMNS, "5c")
    size = int.from_bytes(data[132:136], "little")
    inner = bytearray(zlib.decompress(data[136 : 136 + size]))
    inner[at : at + 4] = value.to_bytes(4, "little")
    packed = zlib.compress(bytes(inner))
    sentence("a.mat", data[:132] + len(packed).to_bytes(4, "little") + packed)


@pytest.fixture
def bag(tmp_path):
    for name, content in valid_files.bag().items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    return tmp_path / "bag"


@pytest.mark.parametrize(
    "damage",
    [
        lambda bag: (bag / "metadata.yaml").write_text("a: [b: {c"),
        lambda bag: (bag / "metadata.yaml").write_text("a: 1\n" * 100_000),
        lambda bag: (bag / "bag.db3").write_bytes(b"SQLite format 3\0" + bytes(5000)),
        lambda bag: os.truncate(bag / "bag.db3", 5000),
        lambda bag: [(bag / f"{k}.db3").touch() for k in range(101)],
    ],
    ids=["YAML", "long", "empty base", "cut", "files"],
)
def test_a_damaged_bag_is_refused(sentence, bag, damage):
    damage(bag)
    sentence("bag", kind="rosbag")


def test_a_compressed_bag_does_not_fill_the_disk(sentence, bag, monkeypatch, tmp_path):
    base = sqlite3.connect(bag / "bag.db3")
    base.execute("CREATE TABLE filler AS SELECT zeroblob(3000000) AS zeros")
    base.commit()
    base.close()
    data = (bag / "bag.db3").read_bytes()
    (bag / "bag.db3").unlink()
    (bag / "bag.db3.zstd").write_bytes(zstandard.compress(data))
    facts = (bag / "metadata.yaml").read_text().replace("bag.db3", "bag.db3.zstd")
    facts = facts.replace("compression_format: ''", "compression_format: zstd")
    (bag / "metadata.yaml").write_text(
        facts.replace("compression_mode: ''", "compression_mode: FILE")
    )
    monkeypatch.setattr("models.trials.guarded_call.MOST_WRITTEN_BYTES", 1_000_000)
    assert "File too large" in sentence("bag", kind="rosbag")


@pytest.mark.parametrize(
    "content", [b'[{"stamp": ' + b"9" * 400 + b"}]", b"[" * 100_000, b'{"stamp": 1e', b'"\\ud800"']
)
def test_deep_and_huge_json_is_refused(sentence, content):
    sentence("a.json", content)


@pytest.mark.parametrize("name", ["../x", "/tmp/x", "a\nb", "x" * 300])
def test_a_name_does_not_leave_the_directory(sentence, tmp_path, name):
    (tmp_path / "out").mkdir()
    assert "is no name of a trial" in sentence("a.csv", CSV.encode(), more=("--name", name))
    assert not list((tmp_path / "out").iterdir())
