"""Benchmark of a tick's computing time, at the control period, with servos in memory.

The period matters: between two ticks the caches go cold, and the same work takes two to three times
as long as in a hot loop (docs/sources.md, "Dynamixel SDK").
"""

from __future__ import annotations

import argparse
import contextlib
import math
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.config import BusConfig, RobotConfig, ServoConfig
from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.errors import InputError
from firmware_py.core.motion import MotionConfig
from firmware_py.core.signals import STAGES
from firmware_py.core.units import CPU_TIME
from firmware_py.inference.bundle import ModelBundle
from firmware_py.robot import LoopModels, NoModels, build_bus, build_loop
from firmware_py.system.clock import DeadlineClock, real_time
from firmware_py.system.kernel_counters import KernelCounters

EXAMPLE = "dropstitch bench --bundle build/bundle_2dof --seconds 20"

OWN_COST_P99_NS: Final = 1_000_000
"""Target for a tick in real time without its wait for the bus."""
_MODEL: Final = "H54-200-S500-R"

LEAST_S, MOST_S = 0.1, 86400.0
"""Range of the benchmark's duration: some ticks to a day [assumed]."""


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--bundle",
        type=Path,
        metavar="BUNDLE",
        help="bundle whose estimator and predictor run (default: neither)",
    )
    parser.add_argument(
        "--dof", type=int, choices=(1, 2), help="number of joints (of the bundle; without it 2)"
    )
    parser.add_argument(
        "--runtime", choices=("onnx", "compiled"),
        help="what evaluates the predictor (default: compiled, where the bundle has it)",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=20.0, help="duration (20)")


def run(args: argparse.Namespace) -> int:
    """Measure; the verdict is negative if the computing time exceeds its limit."""
    if not LEAST_S <= args.seconds <= MOST_S:
        raise InputError("--seconds", f"is {args.seconds:g} s", f"give {LEAST_S:g} to {MOST_S:g} s")
    dof, models = _models(args)
    config = RobotConfig(
        bundle="", bus=BusConfig(port="memory"), motion=MotionConfig(rest_s=0.0),
        servos=tuple(ServoConfig(id=joint, model=_MODEL) for joint in range(1, dof + 1)),
    )  # fmt: skip
    clock = DeadlineClock()
    servos = {setup.id: setup.model for setup in config.setups()}
    bus = build_bus(config, LoopbackTransport(servos), clock)
    slots = math.ceil(args.seconds / config.period_s)
    with (
        contextlib.closing(KernelCounters()) as counters,
        real_time(config.real_time) as refused,
    ):
        summary = build_loop(config, models, bus, clock, slots=slots, counters=counters).run()
    stages = {name: summary.timing.stages[name].summary() for name in (*STAGES, "busy", "own")}
    good = stages["own"].p99_ns <= OWN_COST_P99_NS
    lines = [f"{'stage':>10} {'p50':>8} {'p99':>8} {'max':>8}  µs"]
    lines += [
        f"{name:>10} "
        + " ".join(f"{CPU_TIME.number(ns, 1):>8}" for ns in (s.p50_ns, s.p99_ns, s.max_ns))
        for name, s in stages.items()
    ]
    lines += [f"note: {sentence}" for sentence in refused]
    lines.append(
        f"own cost p99 {CPU_TIME.number(stages['own'].p99_ns)} µs of at most "
        f"{CPU_TIME.number(OWN_COST_P99_NS)} µs in {summary.ticks} ticks, "
        f"{summary.timing.misses} slots missed: " + ("good" if good else "too much")
    )
    document = summary.document(None, bus.plan.name)
    verdict = {"dof": dof, "limit_own_p99_ns": OWN_COST_P99_NS, "good": good}
    emit(args, msgspec.to_builtins(document) | verdict, "\n".join(lines))
    return DONE if good else NEGATIVE


def _models(args: argparse.Namespace) -> tuple[int, LoopModels]:
    if args.bundle is None:
        return args.dof or 2, NoModels()
    bundle = ModelBundle.load(args.bundle, runtime=args.runtime)
    dof = bundle.manifest.dof
    if args.dof not in (None, dof):
        raise InputError("--dof", f"is {args.dof}, {args.bundle} has {dof}", "leave --dof out")
    return dof, bundle
