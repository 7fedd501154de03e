"""Run of the control loop: drive the servos along the configured motion, predict, supervise, log.

Every end that the program can handle brings the arm to rest and switches the torque off: the end of
the motion, Ctrl-C, SIGTERM, SIGHUP (a closed terminal, a lost ssh session) and every other signal
that can be handled, a stop by the supervisor, an exception. The exit code is 0 if no fault stopped
the robot or occurred while it stopped, every servo confirmed torque off, and the log has every
tick; else it is 1. The summary counts retried reads, single ticks without data and missed slots.

The torque stays on after SIGKILL, SIGSTOP, a crash of Python or of the kernel, and a power loss of
the PC. A servo with a bus watchdog then stops and holds its position; a legacy PRO (-R), which has
none, moves to its last goal and holds it. Switch the torque off with 'dropstitch release', or
switch the power of the servos off.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import math
import os
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from firmware_py.bus.servo_models import GAINS, PRESETS
from firmware_py.commands.payload_check import contradicted_payload, unused_payload
from firmware_py.config import RobotConfig, check_config, read_config
from firmware_py.core.console import DONE, NEGATIVE, emit
from firmware_py.core.documents import write_document
from firmware_py.core.errors import InputError, SafetyTrip
from firmware_py.core.motion import KINDS
from firmware_py.core.units import CPU_TIME, DURATION
from firmware_py.goals.for_robot import (
    RunGoals,
    goals_of_motion,
    goals_of_plan,
    goals_of_program,
    outside_goals,
)
from firmware_py.goals.plan_goals import payload_beyond_plan
from firmware_py.goals.tip_plan import TipPlan, read_tip_plan
from firmware_py.inference.bundle import ModelBundle
from firmware_py.inference.bundle_signature import SIGNATURE
from firmware_py.inference.range_check import RangeWatch
from firmware_py.link.link_facts import facts_of_plant
from firmware_py.log.recorder import recording
from firmware_py.log.recording import SLOTS_KEY
from firmware_py.log.telemetry import Telemetry
from firmware_py.robot import build_loop, load_bundle, log_metadata, open_bus, with_bundle_gains
from firmware_py.summary import Ended, RunDocument, RunSummary
from firmware_py.system.clock import DeadlineClock, real_time
from firmware_py.system.kernel_counters import KernelCounters
from firmware_py.system.service import SystemdService

Settings = tuple[dict[str, int], ...]
EXAMPLE = "dropstitch run --config robot.toml --seconds 30"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="ROBOT", help="robot.toml")
    parser.add_argument(
        "--seconds", type=float, help="repeat the motion for this time (default: run it once)"
    )
    parser.add_argument(
        "--motion",
        metavar="KIND|FILE",
        help=f"motion instead of the configured one: {', '.join(KINDS)}, or a motion file",
    )
    parser.add_argument(
        "--amplitude-deg", type=float, help="amplitude instead of the configured one"
    )
    parser.add_argument(
        "--plan", type=Path, metavar="PLAN",
        help="plan of a path of the tip instead of the motion, see 'dropstitch plan'",
    )  # fmt: skip
    parser.add_argument(
        "--goals", metavar="unix:PATH",
        help="goals of another program, one message a tick, instead of the motion",
    )  # fmt: skip
    parser.add_argument(
        "--goal-map", type=Path, metavar="MAP",
        help="with --goals: goals at rest and modes, see 'dropstitch goalmap'",
    )  # fmt: skip
    parser.add_argument(
        "--payload-kg", type=float, metavar="KG", help="mass at the tip, instead of payload_kg"
    )
    parser.add_argument(
        "--open-loop", action="store_true", help="run the plan without feedback of the tip"
    )
    parser.add_argument("--log", type=Path, help="log file (default: in the configured directory)")
    parser.add_argument(
        "--live", action="store_true", help="serve the ticks to Foxglove at the address in [live]"
    )


def run(args: argparse.Namespace) -> int:
    config = _overridden(read_config(args.config), args)
    plan = read_tip_plan(args.plan) if args.plan is not None else None
    bundle = load_bundle(config, args.config)
    config = with_bundle_gains(config, bundle, args.config)
    slots = None if args.seconds is None else math.ceil(args.seconds / config.period_s)
    clock = DeadlineClock()
    with contextlib.ExitStack() as stack:
        goals = stack.enter_context(_goals(args, plan, config, bundle))
        bus = stack.enter_context(open_bus(config, clock))
        settings = bus.read_settings()
        unused = unused_payload(bundle, config.payload_kg)
        unlike = [*_unlike(config, bundle), *_uncompared(config, settings)]
        _say("dropstitch", _origin(bundle), *unlike, unused, goals.note)
        # Goals of another program end when that program ends them.
        last = goals.source.slots if slots is None and args.goals is None else slots
        facts = goals.metadata | ({} if last is None else {SLOTS_KEY: str(last)})
        telemetry, log = stack.enter_context(
            _telemetry(config, args, bundle, settings, goals.name, facts)
        )
        counters = stack.enter_context(contextlib.closing(KernelCounters()))
        service = stack.enter_context(contextlib.closing(SystemdService(clock)))
        watch = RangeWatch(bundle)
        loop = build_loop(
            config, watch, bus, clock, goals=goals.source, correction=goals.correction,
            slots=slots, telemetry=telemetry, counters=counters, service=service,
        )  # fmt: skip
        _say("dropstitch", *stack.enter_context(real_time(config.real_time)))
        summary = loop.run()
    doubt = contradicted_payload(bundle, config.payload_kg, config.period_s, summary, log)
    if plan is not None:
        doubt = doubt or payload_beyond_plan(plan, config.payload_kg, summary)
    document = summary.document(log, bus.plan.name, doubt, telemetry.logged, watch.reasons())
    if log is not None:
        _write_summary(log.with_suffix(".timing.json"), document)
    _tell(args, document, describe(summary, document))
    lacking = lacking_ticks(document)
    _say("warning", doubt, lacking)
    if summary.ended is Ended.TRIPPED:
        raise SafetyTrip(summary.reason, summary.records)
    return NEGATIVE if lacking else DONE


@contextlib.contextmanager
def _goals(
    args: argparse.Namespace, plan: TipPlan | None, config: RobotConfig, bundle: ModelBundle
) -> Iterator[RunGoals]:
    if args.goals is not None:
        with outside_goals(args.goals, args.goal_map, config, bundle) as outside:
            yield goals_of_program(outside)
    elif plan is not None:
        yield goals_of_plan(plan, config, bundle, f"plan {args.plan}")
    else:
        yield goals_of_motion(config, repeated=args.seconds is not None)


def lacking_ticks(document: RunDocument) -> str:
    """Return a sentence if ticks are missing in the log of a run, or ""."""
    logged = document.logged_ticks
    if document.log is None or logged == document.ticks:
        return ""
    count = "an unknown number" if logged is None else str(logged)
    return (
        f"the log {document.log} holds {count} of {document.ticks} ticks (exit code 1): look for a "
        "full disk, or for a recorder that was killed or too slow"
    )


def _say(who: str, *sentences: str) -> None:
    """Print all sentences that are not empty on stderr."""
    for sentence in filter(None, sentences):
        print(f"{who}: {sentence}", file=sys.stderr)


def _write_summary(path: Path, document: RunDocument) -> None:
    """Write the summary beside the log; a full disk must not hide the result of the run."""
    try:
        write_document(path, document)
    except OSError as error:
        print(f"dropstitch: {path}: cannot be written ({error.strerror})", file=sys.stderr)


def _tell(args: argparse.Namespace, document: RunDocument, text: str) -> None:
    """Print the result; a closed terminal or pipe must not change the exit code."""
    with contextlib.suppress(OSError):
        emit(args, msgspec.to_builtins(document), text)
        sys.stdout.flush()


def _overridden(config: RobotConfig, args: argparse.Namespace) -> RobotConfig:
    if args.seconds is not None and not 0 < args.seconds < math.inf:
        raise InputError("--seconds", f"is {args.seconds}", "give a positive time")
    if args.plan is not None and (args.motion is not None or args.amplitude_deg is not None):
        raise InputError("--plan", "is given beside a motion", "leave one out")
    if args.goals is not None and (args.plan, args.motion, args.amplitude_deg) != (None,) * 3:
        raise InputError("--goals", "is given beside a plan or a motion", "leave one out")
    if args.goal_map is not None and args.goals is None:
        raise InputError("--goal-map", "is given without --goals", "leave it out")
    if args.open_loop and args.plan is None:
        raise InputError("--open-loop", "is given without --plan", "leave it out")
    if args.log is not None and not config.record:
        raise InputError("--log", "is given, but record = false", "set record = true in the file")
    if args.log is not None:
        _check_free(args.log)
    motion = config.motion
    if args.motion is not None:
        motion = motion.with_motion(args.motion)
    if args.amplitude_deg is not None:
        motion = msgspec.structs.replace(motion, amplitude_rad=math.radians(args.amplitude_deg))
    config = msgspec.structs.replace(config, motion=motion)
    if args.open_loop:
        feedback = msgspec.structs.replace(config.feedback, use=False)
        config = msgspec.structs.replace(config, feedback=feedback)
    if args.payload_kg is not None:
        config = msgspec.structs.replace(config, payload_kg=args.payload_kg)
        check_config(config, "--payload-kg")
    return config


def _origin(bundle: ModelBundle) -> str:
    """Return a sentence about the origin of the bundle, which contains code."""
    if bundle.signature:
        return f"the bundle {bundle.directory} is signed by {bundle.signature.key}"
    signed = (bundle.directory / SIGNATURE).exists()
    state = "has a signature that is not checked" if signed else "is not signed"
    return (
        f"the bundle {bundle.directory} {state}, and it holds code that runs here: add the key of "
        "its maker to [trust] keys to refuse any other"
    )


def _check_free(log: Path) -> None:
    """Refuse a log if it or its summary would overwrite a file."""
    for path in (log, log.with_suffix(".timing.json")):
        if os.path.lexists(path):
            raise InputError("--log", f"{path} exists", "name a new file, or move that one away")


def _free_log(directory: Path, name: str) -> Path:
    """Return the first unused log of a name, since robots may share a directory."""
    names = itertools.chain([name], (f"{name}_{k}" for k in itertools.count(2)))
    logs = (directory / f"{stem}.mcap" for stem in names)
    return next(
        log for log in logs
        if not any(os.path.lexists(path) for path in (log, log.with_suffix(".timing.json")))
    )  # fmt: skip


def _unlike(config: RobotConfig, bundle: ModelBundle) -> Iterator[str]:
    """Yield a sentence for every servo, and the period, that are not those of the bundle."""
    period_s, facts = bundle.manifest.period_s, facts_of_plant(bundle.plant)
    if not math.isclose(config.period_s, period_s):
        yield (
            f"the bundle was trained at {DURATION.text(period_s)}, this robot runs at "
            f"{DURATION.text(config.period_s)}: its errors were measured at the former only"
        )
    trained = PRESETS.get(facts.servo) if facts else None
    if facts is None or trained is None:
        return
    for servo in config.servos:
        preset = PRESETS[servo.model]
        if preset != trained:
            ratio = preset.torque_constant_nm_a / trained.torque_constant_nm_a
            yield (
                f"servo {servo.id} is a {servo.model} with {ratio:.2g} times the torque per ampere "
                f"of the {facts.servo} in the bundle's plant: train a bundle for it, or expect "
                "predictions out of range"
            )


def _uncompared(config: RobotConfig, settings: Settings) -> Iterator[str]:
    """Yield a sentence for every servo whose gains are not in the configuration."""
    for servo, registers in zip(config.servos, settings, strict=True):
        if servo.gains is None:
            gains = {name: registers[r.value] for name, r in GAINS.items() if r.value in registers}
            text = ", ".join(f"{name} = {raw}" for name, raw in gains.items())
            yield (
                f"the gains of servo {servo.id} are compared with none; if the plant was "
                f"identified with them, add gains = {{ {text} }} in [[servos]]"
            )


@contextlib.contextmanager
def _telemetry(
    config: RobotConfig,
    args: argparse.Namespace,
    bundle: ModelBundle,
    settings: Settings,
    motion: str,
    facts: dict[str, str],
) -> Iterator[tuple[Telemetry, Path | None]]:
    if not (config.record or args.live):
        yield Telemetry(), None
        return
    started = datetime.now(UTC)
    name = f"{started:%Y%m%dT%H%M%SZ}_{motion}"
    log_file = args.log or _free_log(args.config.parent / config.logs, name)
    log = log_file if config.record else None
    live = config.live if args.live else None
    metadata = log_metadata(config, bundle, started, settings) | facts
    with recording(log, config.dof, time.time_ns(), metadata, live) as telemetry:
        yield telemetry, log


def describe(summary: RunSummary, document: RunDocument) -> str:
    busy, own = (summary.timing.stages[name].summary() for name in ("busy", "own"))
    faults = ", ".join(f"{n} {name}" for name, n in summary.bus_faults.items()) or "none"
    lines = [
        f"{summary.ended.value}: {summary.reason}",
        f"{summary.ticks} ticks, {summary.timing.misses} slots missed, bus faults: {faults}",
        f"tick p50 {CPU_TIME.number(busy.p50_ns)} µs, p99 {CPU_TIME.number(busy.p99_ns)} µs, "
        f"max {CPU_TIME.number(busy.max_ns)} µs; own cost p50 {CPU_TIME.number(own.p50_ns)} µs, "
        f"p99 {CPU_TIME.number(own.p99_ns)} µs",
    ]
    if summary.replugs:
        lines.append(f"continued {summary.replugs} times after the port had gone")
    if summary.out_of_range:
        outside = f"{summary.out_of_range} ticks outside the predictor's training range"
        lines.append(": ".join(filter(None, (outside, document.out_of_range_reasons.note))))
    if summary.feedback.note:
        lines.append(summary.feedback.note)
    if document.log is not None:
        logged = document.logged_ticks
        known = "number of ticks unknown: the recorder did not end as it should"
        if logged is not None:
            known = f"{logged} of {summary.ticks} ticks"
        lines.append(f"log: {document.log} ({known})")
    return "\n".join([*lines, f"servos were read by {document.bus_plan}"])
