"""Time of one prediction: graphs of this project, skl2onnx's conversion, scikit-learn.

Every case times its contenders in turn, a few calls each, in several rounds, so that a change of
the machine's speed affects all of them. Batch 1, float64, the same fitted pipeline for all:

bare        power form, IO binding (`models.predictor.onnx_graphs` without guard and interval)
deployed    the bundle's graph: guard, prediction, in_range, 95 % interval; IO binding
default     skl2onnx's conversion, onnxruntime's default options, `session.run`
sklearn     `pipeline.predict`

Writes OUT/onnx.json.

    python -m bench.onnx --out build/bench
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
from skl2onnx import convert_sklearn
from skl2onnx.common.data_types import DoubleTensorType

from firmware_py.core.console import DONE, Progress
from firmware_py.inference.predictor import OnnxGraph, OnnxPredictor
from models.predictor.onnx_graphs import to_onnx
from models.predictor.polynomials import DEGREES, GuardedPredictor, Polynomial

CONTENDERS = ("bare", "deployed", "default", "sklearn")
ROUNDS, WARM_UP = 40, 5
ROWS = 2560

Cases = dict[tuple[int, int], dict[str, Any]]
"""By number of inputs and degree."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.onnx", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("build/bench"), help="build/bench")
    parser.add_argument("--calls", type=int, default=1200, help="timed calls per case (1200)")
    args = parser.parse_args(argv)
    cases = measure_all(args.calls)
    print("median (p99) of one prediction in µs", end="\n\n")
    header = "".join(f"{name:>19}" for name in CONTENDERS)
    print(f"inputs degree{header}   largest difference")
    for (inputs, degree), case in cases.items():
        cells = "".join(f"{case[n]['p50_us']:10.1f} ({case[n]['p99_us']:6.0f})" for n in CONTENDERS)
        print(f"{inputs:6d} {degree:6d}{cells}   {case['largest_difference_m']:.0e} m")
    for fast in ("bare", "deployed"):
        for slow in ("default", "sklearn"):
            speed_up = ratio(cases, slow, fast)
            print(f"{fast} against {slow}: {speed_up['mean']:.1f} times, "
                  f"{speed_up['least']:.1f} to {speed_up['most']:.1f}")  # fmt: skip
    args.out.mkdir(parents=True, exist_ok=True)
    rows = [{"inputs": n, "degree": d, **case} for (n, d), case in cases.items()]
    (args.out / "onnx.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return DONE


def measure_all(calls: int) -> Cases:
    """Every number of inputs and degree."""
    progress, cases = Progress("ONNX", 2 * len(DEGREES)), {}
    for inputs in (3, 5):
        for degree in DEGREES:
            cases[inputs, degree] = measure(inputs, degree, calls)
            progress.step(f"{inputs} inputs, degree {degree}")
    return cases


def ratio(cases: Cases, slow: str, fast: str) -> dict[str, float]:
    """Median time of one contender over that of another: geometric mean over the cases, range."""
    ratios = [case[slow]["p50_us"] / case[fast]["p50_us"] for case in cases.values()]
    mean = float(np.exp(np.mean(np.log(ratios))))
    return {"mean": mean, "least": min(ratios), "most": max(ratios)}


def measure(inputs: int, degree: int, calls: int) -> dict[str, Any]:
    """Time one case; returns quantiles in µs by contender and the largest difference of results."""
    rng = np.random.default_rng(degree)
    size = np.array([0.52, 3.0, 0.004] if inputs == 3 else [0.52, 0.52, 3.0, 3.0, 0.004])
    features = rng.uniform(-1, 1, (ROWS, inputs)) * size
    targets = np.column_stack([np.sin(features @ (0.5 / size) + phase) for phase in range(3)])
    targets += 1e-3 * rng.standard_normal(targets.shape)
    predictor = GuardedPredictor.fit(
        degree, features, targets, [(np.arange(500, ROWS), np.arange(500))]
    )
    with tempfile.TemporaryDirectory() as scratch:
        run = _contenders(predictor, inputs, Path(scratch))
        points = features[rng.integers(ROWS, size=64)]
        answers = {name: np.array([call(p) for p in points]) for name, call in run.items()}
        samples_ns: dict[str, list[int]] = {name: [] for name in CONTENDERS}
        for _ in range(ROUNDS):
            for name in CONTENDERS:
                samples_ns[name] += _time(run[name], points, max(1, calls // ROUNDS))
    quantiles = {
        name: {f"p{q}_us": float(np.percentile(ns, q)) / 1e3 for q in (50, 99)}
        for name, ns in samples_ns.items()
    }
    difference_m = max(float(np.abs(a - answers["sklearn"]).max()) for a in answers.values())
    return quantiles | {"largest_difference_m": difference_m}


def _contenders(
    predictor: GuardedPredictor, inputs: int, scratch: Path
) -> dict[str, Callable[[Any], Any]]:
    pipeline, dof = predictor.polynomial.pipeline, inputs // 2
    polynomial = Polynomial.of(pipeline)
    bare_graph = to_onnx(
        lambda graph, source: polynomial.write(graph, source, "tip", "tip_m"),
        inputs, outputs={"tip_m": 3},
    )  # fmt: skip
    onnx.save(bare_graph, scratch / "bare.onnx")
    onnx.save(to_onnx(predictor.write_graph, inputs), scratch / "deployed.onnx")
    default = ort.InferenceSession(
        convert_sklearn(
            pipeline, initial_types=[("features", DoubleTensorType([None, inputs]))]
        ).SerializeToString()
    )
    graph = OnnxGraph(scratch / "bare.onnx", inputs, (("tip_m", 3),))
    deployed_graph = OnnxPredictor(scratch / "deployed.onnx", dof)

    def bare(point: Any) -> Any:
        graph.row[:] = point
        graph.run()
        return graph.results[0].copy()

    def deployed(point: Any) -> Any:
        return deployed_graph.predict(point[:dof], point[dof:-1], point[-1]).tip_m.copy()

    return {
        "bare": bare,
        "deployed": deployed,
        "default": lambda point: default.run(None, {"features": point[None]})[0][0],
        "sklearn": lambda point: pipeline.predict(point[None])[0],
    }


def _time(call: Callable[[Any], Any], points: Any, count: int) -> list[int]:
    for k in range(WARM_UP):  # the previous contender has replaced the caches' content
        call(points[k])
    samples_ns = []
    for k in range(count):
        point = points[k % len(points)]
        start_ns = time.perf_counter_ns()
        call(point)
        samples_ns.append(time.perf_counter_ns() - start_ns)
    return samples_ns


if __name__ == "__main__":
    sys.exit(main())
