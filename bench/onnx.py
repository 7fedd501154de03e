"""Time of one prediction: graphs of this project, skl2onnx's conversion, scikit-learn.

Every case times its contenders in turn, a few calls each, in several rounds, so that a change of
the machine's speed affects all of them. Batch 1, float64, the same fitted pipeline for all:

bare        power form, IO binding (`models.learning.onnx_power` without guard and interval)
deployed    the bundle's graph: guard, prediction, in_range, 95 % interval; IO binding
default     skl2onnx's conversion, onnxruntime's default options, `session.run`
sklearn     `pipeline.predict`

Writes BENCH/onnx.json and BENCH/onnx.svg; exit 1 if a limit is missed.

    python -m bench.onnx --out build/bench
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
import onnxruntime as ort
from skl2onnx import convert_sklearn
from skl2onnx.common.data_types import DoubleTensorType

from firmware_py.console import DONE, NEGATIVE, Progress
from firmware_py.inference.predictor import OnnxGraph, OnnxPredictor
from models.learning.onnx_power import PolynomialGraph, to_onnx
from models.learning.predictors import DEGREES, GuardedPredictor

CONTENDERS = ("bare", "deployed", "default", "sklearn")
ROUNDS, WARM_UP = 40, 5
ROWS = 2560


class Limit(NamedTuple):
    """Least ratio of the median of `slow` to that of `fast`."""

    name: str
    slow: str
    fast: str
    case: tuple[int, int] | None  # (inputs, degree), or None for the geometric mean over all
    at_least: float


LIMITS = (
    Limit("bare against default, geometric mean", "default", "bare", None, 5.0),
    Limit("bare against default, 5 inputs, degree 6", "default", "bare", (5, 6), 30.0),
    Limit("bare against scikit-learn, geometric mean", "sklearn", "bare", None, 30.0),
    Limit("deployed against default, 5 inputs, degree 6", "default", "deployed", (5, 6), 15.0),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.onnx", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("build/bench"), help="build/bench")
    parser.add_argument("--calls", type=int, default=1200, help="timed calls per case (1200)")
    args = parser.parse_args(argv)
    progress = Progress("bench", 2 * len(DEGREES))
    cases = {}
    for inputs in (3, 5):
        for degree in DEGREES:
            cases[inputs, degree] = measure(inputs, degree, args.calls)
            progress.step(f"{inputs} inputs, degree {degree}")
    verdicts = [_judge(limit, cases) for limit in LIMITS]
    print(_table(cases, verdicts))
    args.out.mkdir(parents=True, exist_ok=True)
    document = {
        "cases": [{"inputs": n, "degree": d, **case} for (n, d), case in cases.items()],
        "limits": verdicts,
        "environment": {
            "python": platform.python_version(), "machine": platform.machine(),
            **{name: version(name) for name in ("onnxruntime", "skl2onnx", "scikit-learn")},
        },
    }  # fmt: skip
    (args.out / "onnx.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    draw(cases, args.out / "onnx.svg")
    return DONE if all(verdict["met"] for verdict in verdicts) else NEGATIVE


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
    pipeline, dof = predictor.pipeline, inputs // 2
    onnx.save(to_onnx(PolynomialGraph(pipeline, "tip_m"), inputs), scratch / "bare.onnx")
    onnx.save(to_onnx(predictor, inputs), scratch / "deployed.onnx")
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


def _judge(limit: Limit, cases: dict[tuple[int, int], dict[str, Any]]) -> dict[str, Any]:
    chosen = list(cases) if limit.case is None else [limit.case]
    ratios = [cases[c][limit.slow]["p50_us"] / cases[c][limit.fast]["p50_us"] for c in chosen]
    ratio = float(np.exp(np.mean(np.log(ratios))))
    return {
        "limit": limit.name, "ratio": ratio, "at_least": limit.at_least,
        "smallest": min(ratios), "met": ratio >= limit.at_least,
    }  # fmt: skip


def _table(cases: dict[tuple[int, int], dict[str, Any]], verdicts: list[dict[str, Any]]) -> str:
    lines = ["median (p99) of one prediction in µs", ""]
    header = "".join(f"{name:>19}" for name in CONTENDERS)
    lines.append(f"inputs degree{header}   largest difference")
    for (inputs, degree), case in cases.items():
        cells = "".join(f"{case[n]['p50_us']:10.1f} ({case[n]['p99_us']:6.0f})" for n in CONTENDERS)
        lines.append(f"{inputs:6d} {degree:6d}{cells}   {case['largest_difference_m']:.0e} m")
    lines.append("")
    lines += [
        f"{'met   ' if v['met'] else 'MISSED'} {v['limit']}: {v['ratio']:.1f} times "
        f"(at least {v['at_least']:g}; smallest {v['smallest']:.1f})"
        for v in verdicts
    ]
    return "\n".join(lines)


def draw(cases: dict[tuple[int, int], dict[str, Any]], path: Path) -> None:
    """Draw the medians over the degree, one panel per number of inputs."""
    from matplotlib import pyplot as plt

    from models.shared.svg_drawing import FILE_STYLE  # loads matplotlib

    with plt.rc_context(FILE_STYLE):
        figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
        for panel, inputs in zip(panels, (3, 5), strict=True):
            for name in CONTENDERS:
                medians = [cases[inputs, degree][name]["p50_us"] for degree in DEGREES]
                panel.plot(DEGREES, medians, marker="o", label=name)
            panel.set(yscale="log", xlabel="degree", title=f"{inputs} inputs ({inputs // 2}DOF)")
        panels[0].set_ylabel("median time of one prediction in µs")
        panels[0].legend()
        figure.savefig(path, format="svg", metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    sys.exit(main())
