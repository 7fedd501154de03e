"""Files of every wrong kind: one sentence each, and nothing allocated before it."""

import os
import resource
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from firmware_py.config import read_config
from firmware_py.core import input_files
from firmware_py.core.documents import read_document
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import (
    limited_memory,
    read_bytes,
    read_json,
    read_lines,
    read_text,
    read_toml,
    resolved,
)
from firmware_py.core.motion import read_motion_document
from firmware_py.inference.bundle import read_manifest
from firmware_py.inference.predictor import OnnxPredictor
from firmware_py.summary import RunDocument
from models.plan.paths import read_path
from models.plant.plant import read_plant
from models.rig.parameters import read_parameters
from models.trials.recordings.mapping import read_mapping

linux_only = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux limits the address space"
)

READERS = {
    "robot.toml": read_config, "motion.toml": read_motion_document, "plant.toml": read_plant,
    "plant.json": read_plant, "rig.toml": read_parameters, "map.toml": read_mapping,
    "run.timing.json": lambda path: read_document(path, RunDocument),
    "path.csv": lambda path: read_path(path, 2, 0.017),
    "manifest.json": lambda path: read_manifest(path.parent),
}  # fmt: skip
HOSTILE = {
    "Latin-1": "schema = 'é'".encode("latin-1"), "zeros": bytes(100), "nothing": b"",
    "nested lists": b"a = " + b"[" * 50_000, "nested objects": b'{"a":' * 50_000,
    "many digits": b'{"schema": ' + b"9" * 10_000 + b"}", "dotted": b"a." * 100_000 + b"a = 1",
    "digits in TOML": b"schema = " + b"9" * 10_000, "infinite": b'{"schema": 1e999}',
    "a list": b"[1, 2]", "huge integer": b'{"schema": 1, "ticks": ' + b"9" * 400 + b"}",
}  # fmt: skip


def sentence(read, path):
    with pytest.raises(InputError) as refused:
        read(path)
    text = str(refused.value)
    assert text.startswith(f"{path}: ") and text.endswith(".") and text.isprintable()
    return text


@pytest.mark.parametrize("name", READERS)
def test_every_reader_refuses_a_wrong_file_in_one_sentence(tmp_path, name):
    path = tmp_path / name
    assert "is missing" in sentence(READERS[name], path)
    path.mkdir()
    assert "is no file but a directory" in sentence(READERS[name], path)
    path.rmdir()
    os.mkfifo(path)  # without a writer; opening it must not wait
    assert "is no file but a device or a pipe" in sentence(READERS[name], path)
    path.unlink()
    for kind, content in HOSTILE.items():
        if kind != "nothing" or name not in ("map.toml", "rig.toml"):  # these have defaults
            path.write_bytes(content)
            sentence(READERS[name], path)


@pytest.mark.parametrize("name", [name for name in READERS if name.endswith(".toml")])
def test_toml_of_a_windows_editor_is_read_or_refused_for_its_encoding(tmp_path, name):
    """A byte order mark changes nothing; UTF-16 and ANSI are named."""
    path = tmp_path / name
    path.write_text("schema == 1", encoding="utf-8-sig")  # the same complaint as without the mark
    assert "at line 1, column 9" in sentence(READERS[name], path)
    path.write_text("schema = 1", encoding="utf-16")
    assert sentence(READERS[name], path).endswith("is UTF-16 text; save it as UTF-8.")
    path.write_text("# 30°", encoding="latin-1")
    assert sentence(READERS[name], path).endswith("; save it as UTF-8.")


@pytest.mark.parametrize("digits", ["-1" + "0" * 25, "0x" + "f" * 4000])
@pytest.mark.parametrize("name", [name for name in READERS if name.endswith(".toml")])
def test_an_integer_of_toml_has_at_most_64_bits(tmp_path, name, digits):
    path = tmp_path / name
    path.write_text(f"schema = 1\n[deep]\nvalues = [{{ a = {digits} }}]\n", encoding="utf-8")
    assert "deep.values.a is an integer beyond 64 bits" in sentence(READERS[name], path)


def test_a_file_above_the_limit_is_not_read(tmp_path):
    path = tmp_path / "sparse"
    path.touch()
    os.truncate(path, input_files.MOST_BYTES + 1)
    assert "is larger than 100 MB" in sentence(lambda p: read_bytes(p, "divide it"), path)
    assert "is larger than 1 MB" in sentence(read_toml, path)
    assert "is larger than 64 MB" in sentence(lambda p: read_json(p, "divide it"), path)
    with pytest.raises(InputError, match="is no file name"):
        read_text("a\0b", "name a file")


def test_the_values_of_json_are_counted_before_it_is_decoded(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"[" + b"[]," * input_files.MOST_JSON_LISTS + b"[]]")
    assert "lists and objects" in sentence(lambda p: read_json(p, "divide it"), path)
    path.write_bytes(b"[" + b"0," * input_files.MOST_JSON_VALUES + b"0]")
    assert "values" in sentence(lambda p: read_json(p, "divide it"), path)
    path.write_text('{"time": [1, 2], "time": [3, 4]}')
    assert "'time' stands twice" in sentence(lambda p: read_json(p, "correct it"), path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_lines_of_a_table_are_read_by_their_byte_order_mark(tmp_path, encoding):
    path = tmp_path / "a.csv"
    path.write_text("ä,b\r\n1,2\r\n", encoding=encoding, newline="")
    assert list(read_lines(path, "")) == ["ä,b\r\n", "1,2\r\n"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"," * (input_files.LONGEST_LINE + 2), "a line of more than"),
        (b"\xff\xfea\x00b", "save it as UTF-8"),
        ("ä,b".encode("latin-1"), "save it as UTF-8"),
    ],
    ids=["endless", "cut off", "Latin-1"],
)
def test_lines_that_are_no_text_are_refused(tmp_path, content, words):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    assert words in sentence(lambda p: list(read_lines(p, "")), path)


def test_texts_of_libraries_and_files_stay_on_one_line():
    error = InputError("a\nb", "first\nsecond\x1b[31m" + "x" * 5000, "do\tthis")
    assert str(error).isprintable() and len(str(error)) < 2000
    assert str(error).startswith("a b: first second\\x1b[31m")


# --- memory -----------------------------------------------------------------------------------


@linux_only
def test_more_memory_than_permitted_is_refused_and_the_limit_ends_with_it():
    before = resource.getrlimit(resource.RLIMIT_AS)
    with (
        pytest.raises(InputError, match=r"^a: takes more than 50 MB to read; b\.$"),
        limited_memory("a", "b", 50_000_000),
    ):
        tight = resource.getrlimit(resource.RLIMIT_AS)
        with limited_memory("a", "b", 500_000_000):
            assert resource.getrlimit(resource.RLIMIT_AS) == tight, "it is not loosened"
        bytearray(2_000_000_000)  # no hole of the heap is as large
    assert resource.getrlimit(resource.RLIMIT_AS) == before


@linux_only
def test_json_that_grows_in_memory_is_refused(tmp_path, monkeypatch):
    """A single wide character makes four bytes of each."""
    (tmp_path / "a.json").write_text('["😀' + "x" * 45_000_000 + '"]', encoding="utf-8")
    monkeypatch.setattr(
        input_files, "limited_memory",
        lambda where, remedy: limited_memory(where, remedy, 50_000_000),
    )  # fmt: skip
    with pytest.raises(InputError, match="takes more than 50 MB to read"):
        read_json(tmp_path / "a.json", "write it again")


@linux_only
def test_a_small_graph_that_makes_large_numbers_is_refused(tmp_path):
    shape = numpy_helper.from_array(np.array([200_000_000], np.int64), "shape")
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["zeros"]),
        helper.make_node("ReduceMean", ["zeros"], ["mean"], keepdims=1),
        helper.make_node("Cast", ["mean"], ["zero"], to=TensorProto.DOUBLE),
        helper.make_node("Add", ["features", "zero"], ["tip_m"]),
        helper.make_node("Identity", ["tip_m"], ["half_width_m"]),
        helper.make_node("ReduceMean", ["tip_m"], ["in_range"], axes=[1]),
    ]
    values = {"features": 3, "tip_m": 3, "in_range": 1, "half_width_m": 3}
    row, *results = (
        helper.make_tensor_value_info(name, TensorProto.DOUBLE, [1, width])
        for name, width in values.items()
    )
    graph = helper.make_graph(nodes, "large", [row], results, [shape])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=7)
    onnx.save(model, tmp_path / "predictor.onnx")
    with pytest.raises(InputError, match=r"cannot be evaluated|onnxruntime can load"):
        OnnxPredictor(tmp_path / "predictor.onnx", 1)


def test_an_integer_of_thousands_of_digits_is_refused_in_our_words(tmp_path):
    path = tmp_path / "long"
    for content, read in (
        ("x = 1" + 5000 * "0", lambda: read_toml(path)),
        ("1" + 5000 * "0", lambda: read_json(path, "write it anew")),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=r"long: .* an integer of more than 4300 digits\);"):
            read()


def test_a_link_that_leads_back_to_itself_is_refused(tmp_path, monkeypatch):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "link").symlink_to("nowhere")
    assert resolved(tmp_path / "link") == tmp_path / "nowhere"
    if sys.version_info < (3, 13):  # from then on only opening it fails
        with pytest.raises(InputError, match="loop: is a symbolic link that leads back to itself"):
            resolved(tmp_path / "loop")
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(InputError, match="name an absolute path"):
        resolved(Path("here"))
