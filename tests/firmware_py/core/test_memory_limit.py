"""Memory of reading a file in this process: bounded, told in one sentence, and given back."""

import resource
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from firmware_py.core import guarded_call, input_files
from firmware_py.core.errors import InputError
from firmware_py.core.guarded_call import limited_memory
from firmware_py.core.input_files import read_json
from firmware_py.inference.predictor import OnnxPredictor

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="no limit of the address space")


def test_more_memory_than_permitted_is_refused_and_the_limit_ends_with_it():
    before = resource.getrlimit(resource.RLIMIT_AS)
    with (
        pytest.raises(InputError, match=r"^a: takes more than 50 MB to read; b\.$"),
        limited_memory("a", "b", 50_000_000),
    ):
        bytearray(2_000_000_000)  # no hole of the heap is as large
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def test_a_limit_within_a_tighter_one_does_not_loosen_it():
    with limited_memory("a", "b", 200_000_000):
        tight = resource.getrlimit(resource.RLIMIT_AS)
        with limited_memory("a", "b", 500_000_000):
            assert resource.getrlimit(resource.RLIMIT_AS) == tight


def test_json_that_grows_in_memory_is_refused(tmp_path, monkeypatch):
    """A single wide character makes four bytes of each."""
    (tmp_path / "a.json").write_text('["😀' + "x" * 45_000_000 + '"]', encoding="utf-8")
    limited = guarded_call.limited_memory
    monkeypatch.setattr(
        input_files, "limited_memory", lambda where, remedy: limited(where, remedy, 50_000_000)
    )
    with pytest.raises(InputError, match="takes more than 50 MB to read"):
        read_json(tmp_path / "a.json", "write it again")


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
