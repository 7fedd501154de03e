"""Foreign files are read in a child process, or with limited memory: one sentence at any end."""

import errno
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from firmware_py.core import guarded_call as guarded_call_module
from firmware_py.core import input_files
from firmware_py.core.errors import InputError
from firmware_py.core.guarded_call import guarded_call, limited_memory
from firmware_py.core.input_files import read_json
from firmware_py.inference.predictor import OnnxPredictor

linux_only = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux limits the address space"
)


def call(work, **limits):
    return guarded_call(work, "a.mat", "export it again", **limits)


def fail(error):
    raise error


def compute_for_ever():
    while True:
        pass


def test_the_result_arrives_whole():
    content = os.urandom(300_000)
    assert call(lambda: content) == content


REFUSAL = InputError("a.mat", "is no table", "export it")
FULL_DISK = OSError(errno.ENOSPC, "No space left on device", "trial.csv")


@pytest.mark.parametrize(
    ("work", "limits", "error", "sentence"),
    [
        (lambda: fail(REFUSAL), {}, InputError, r"^a\.mat: is no table; export it\.$"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), {}, InputError, r"a\.mat: .* crashed; exp"),
        (lambda: 1 / 0, {}, InputError, r"\(ZeroDivisionError: .*; if the file is sound"),
        (lambda: fail(FULL_DISK), {}, OSError, "No space left"),
        (
            lambda: bytes(bytearray(2_000_000_000)), {"memory_bytes": 50_000_000}, InputError,
            "takes more than 50 MB to read",
        ),
        (lambda: time.sleep(60), {"seconds": 0.02}, InputError, r"more than 0\.02 s to read"),
        (compute_for_ever, {"seconds": 0.9}, InputError, r"takes more than 0\.9 s to read"),
    ],
    ids=["refusal", "crash", "internal error", "full disk", "memory", "time", "processor time"],
)  # fmt: skip
def test_any_other_end_is_one_sentence(work, limits, error, sentence):
    start_s = time.monotonic()
    with pytest.raises(error, match=sentence):
        call(work, **limits)
    assert time.monotonic() - start_s < 20


def test_temporary_files_go_with_the_child_and_files_are_limited(monkeypatch):
    monkeypatch.setattr("firmware_py.core.guarded_call.MOST_WRITTEN_BYTES", 1000)

    def work():
        folder = tempfile.mkdtemp()
        Path(folder, "small").write_bytes(bytes(500))
        try:
            Path(folder, "large").write_bytes(bytes(5000))
        except OSError as error:
            return f"{folder}\n{error.errno}".encode()

    folder, number = call(work).decode().split("\n")
    assert os.strerror(int(number)) == "File too large" and not Path(folder).exists()


def test_without_a_fork_the_work_runs_here_with_the_same_sentences(monkeypatch, capfd):
    monkeypatch.delattr(os, "fork")  # as on Windows

    def work():
        print("a library talks")
        return str(os.getpid()).encode()

    assert call(work) == str(os.getpid()).encode()
    assert capfd.readouterr() == ("", "")
    for error, raised, sentence in (
        (REFUSAL, InputError, r"^a\.mat: is no table; ex"),
        (ValueError("codec"), InputError, r"a\.mat: cannot be read \(ValueError: codec\)"),
        (MemoryError(), InputError, r"a\.mat: takes more memory to read than there is"),
        (FULL_DISK, OSError, "No space left"),
    ):
        with pytest.raises(raised, match=sentence):
            call(lambda error=error: fail(error))


# --- in this process ----------------------------------------------------------------------------


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
    limited = guarded_call_module.limited_memory
    monkeypatch.setattr(
        input_files, "limited_memory", lambda where, remedy: limited(where, remedy, 50_000_000)
    )
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
