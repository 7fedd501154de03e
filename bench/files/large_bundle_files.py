"""Large files of a bundle: golden ticks, graphs and FMUs."""

from __future__ import annotations

import zipfile
from pathlib import Path

from bench.files.file_filling import STEP_S
from firmware_py.inference.file_content import LARGEST_BYTES


def _npz(path: Path, ticks: int, *, packed: bool) -> None:
    import numpy as np

    shapes = {"angle_rad": (ticks, 1), "current_a": (ticks, 1), "step_s": (), "di": (ticks,),
              "tip_m": (ticks, 3), "payload_kg": (ticks,)}  # fmt: skip
    rng = np.random.default_rng(1)
    make = np.zeros if packed else rng.random
    arrays = {name: make(shape) for name, shape in shapes.items()}
    (np.savez_compressed if packed else np.savez)(path, **arrays | {"step_s": STEP_S})


def npz(path: Path) -> None:
    """Golden ticks."""
    _npz(path, LARGEST_BYTES // 56 - 100, packed=False)


def npz_bomb(path: Path) -> None:
    """Golden ticks that unpack to a hundred times their size."""
    _npz(path, 14_000_000, packed=True)


def _onnx(path: Path, size: int, fill: int) -> None:
    import numpy as np
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    big = numpy_helper.from_array(np.ones(size // 8), "big")
    names = ("tip_m", 3), ("in_range", 1), ("half_width_m", 3)
    shape = numpy_helper.from_array(np.array([fill], np.int64), "shape")
    nodes = [
        helper.make_node("ReduceMean", ["big"], ["mean"], keepdims=1),
        helper.make_node("ConstantOfShape", ["shape"], ["filled"]),
        helper.make_node("ReduceMean", ["filled"], ["low"], keepdims=1),
        helper.make_node("Cast", ["low"], ["wide"], to=TensorProto.DOUBLE),
        helper.make_node("ReduceMean", ["features"], ["x"], axes=[1], keepdims=1),
        helper.make_node("Add", ["x", "mean"], ["y"]),
        helper.make_node("Add", ["y", "wide"], ["z"]),
    ]  # fmt: skip
    for name, width in names:
        nodes.append(helper.make_node("Concat", ["z"] * width, [name], axis=1))
    row = [helper.make_tensor_value_info("features", TensorProto.DOUBLE, [1, 3])]
    results = [helper.make_tensor_value_info(n, TensorProto.DOUBLE, [1, w]) for n, w in names]
    graph = helper.make_graph(nodes, "large", row, results, [big, shape])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=7)
    onnx.save(model, path)


def onnx_weights(path: Path) -> None:
    """Graph with 64 MB of weights."""
    _onnx(path, LARGEST_BYTES - 10_000, 1)


def onnx_bomb(path: Path) -> None:
    """Graph of a kilobyte that makes 2 GB of zeros."""
    _onnx(path, 800, 500_000_000)


def _fmu(path: Path, members: dict[str, bytes], kind: int) -> None:
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def fmu_large(path: Path) -> None:
    """FMU with resources of 64 MB."""
    _fmu(path, {"modelDescription.xml": b"<fmiModelDescription fmiVersion='3.0'/>",
                "resources/a": bytes(LARGEST_BYTES - 10_000)}, zipfile.ZIP_STORED)  # fmt: skip


def fmu_xml(path: Path) -> None:
    """FMU with an XML file of many elements."""
    text = b"<fmiModelDescription fmiVersion='3.0'><ModelVariables>" + b"<a/>" * 990_000
    text += b"</ModelVariables></fmiModelDescription>"
    _fmu(path, {"modelDescription.xml": text}, zipfile.ZIP_DEFLATED)


def fmu_bomb(path: Path) -> None:
    """FMU with entities that expand to gigabytes."""
    entities = '<!ENTITY e0 "0123456789">' + "".join(
        f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10)
    )
    text = (
        f"<!DOCTYPE a [{entities}]><fmiModelDescription fmiVersion='3.0'>&e9;</fmiModelDescription>"
    )
    _fmu(path, {"modelDescription.xml": text.encode()}, zipfile.ZIP_DEFLATED)
