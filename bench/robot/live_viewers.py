"""Robot's loop with hostile viewers of its live view: what they cost a read, a tick, a slot.

`dropstitch run --live` drives emulated servos in real time, both with SCHED_FIFO, while a process
opens connections to the live view. Each asks for the ticks and reads one small piece in a second;
one that is refused tries again. Probes of real-time priority on both processors and the emulator's
own account are the witnesses of the host: a read that took longer than the robot waits for an
answer, or a slot that was missed, is explained where they saw the host stand still meanwhile.

    python -m bench.robot.live_viewers --bundle build/bundle_1dof --fmu build/twin_1dof.fmu

Writes OUT/live_viewers.json; exit 1 if a read or a slot stays unexplained.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from firmware_py.console import DONE, NEGATIVE, Progress
from firmware_py.inference.bundle import read_manifest
from firmware_py.log.recording import read_recording
from hil.emulator.emulator import Emulator, EmulatorSpecification
from hil.timing.cpu_accounts import ProbeRecord, Releases
from hil.timing.probe import Probe
from hil.timing.processors import assign_processors, pinned_to

MODEL: Final = (54024, "H54-200-S500-R")
CONFIG: Final = """\
bundle = "{bundle}"
[bus]
port = "{port}"
{servos}
[motion]
amplitude_rad = 0.3
[limits]
stale_ticks = 100            # to count losses, not to stop at the third
missed_slots = 1000
[real_time]
cpu = {cpu}
[live]
port = {live}
viewers = {viewers}
"""
TIMEOUT_NS: Final = 8_000_000
"""`bus.reply_timeout_s`, the longest wait for the servos in a tick."""
LATE_NS: Final = 1_000_000
"""Lateness of a reply that can cost an answer, as in the fault campaign."""
_HANDSHAKE: Final = (
    "GET / HTTP/1.1\r\nHost: robot\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
)
_WISH: Final = json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}]})
_PIECE_BYTES: Final = 64


def main(argv: Sequence[str] | None = None) -> int:
    """Run and judge; or, with --view, be the viewers."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.robot.live_viewers", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--bundle", type=Path)
    parser.add_argument("--fmu", type=Path, help="twin of the same dof")
    parser.add_argument("--out", type=Path, default=Path("build/bench"))
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=15.0, help="of a run (15)")
    parser.add_argument("--readers", type=int, default=200, help="connections (200)")
    parser.add_argument("--viewers", type=int, default=100, help="[live] viewers (100)")
    parser.add_argument("--view", type=int, metavar="PORT", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.view is not None:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_view(args.view, args.readers))
        return DONE
    progress, rows = Progress("bench", args.runs), []
    for _ in range(args.runs):
        rows.append(one_run(args))
        progress.step(json.dumps(rows[-1]))
    args.out.mkdir(parents=True, exist_ok=True)
    result = {
        "runs": rows, "ticks": sum(row["ticks"] for row in rows),
        "misses": sum(row["misses"] for row in rows),
        "longest_read_ms": max(row["longest_read_ms"] for row in rows),
        "unexplained": sum(len(row["unexplained"]) for row in rows),
    }  # fmt: skip
    text = json.dumps(result, indent=1) + "\n"
    (args.out / "live_viewers.json").write_text(text, encoding="utf-8")
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))
    return NEGATIVE if result["unexplained"] else DONE


def one_run(args: argparse.Namespace) -> dict[str, Any]:
    """Run the robot once beside its viewers; return the figures of the run."""
    loop_cpu, other_cpus = assign_processors()
    dof = read_manifest(args.bundle).dof
    ids = tuple(range(1, dof + 1))
    with contextlib.ExitStack() as stack:
        scratch = Path(stack.enter_context(TemporaryDirectory(prefix="dropstitch-bench-")))
        stack.enter_context(pinned_to(other_cpus))
        emulator = stack.enter_context(
            contextlib.closing(
                Emulator(
                    EmulatorSpecification(args.fmu, MODEL[0], ids),
                    "socket",
                    scratch,
                    max(other_cpus),
                )
            )
        )
        probes = [
            stack.enter_context(contextlib.closing(Probe(cpu)))
            for cpu in sorted({loop_cpu, max(other_cpus)})
        ]
        port = _free_port()
        servos = "\n".join(f'[[servos]]\nid = {i}\nmodel = "{MODEL[1]}"' for i in ids)
        config = scratch / "robot.toml"
        config.write_text(
            CONFIG.format(
                bundle=args.bundle.resolve(),
                port=emulator.name,
                servos=servos,
                cpu=loop_cpu,
                live=port,
                viewers=args.viewers,
            ),
            encoding="utf-8",
        )
        log = scratch / "ticks.mcap"
        robot = subprocess.Popen(
            [sys.executable, "-m", "firmware_py", "run", "--config", str(config), "--live",
             "--seconds", str(args.seconds), "--log", str(log), "--json"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        admitted = stack.enter_context(_readers(port, args.readers))
        output, words = robot.communicate()
        if robot.returncode:
            print(words, file=sys.stderr)
        records = [probe.stop() for probe in probes]
        releases = emulator.stop().releases
        columns = read_recording(log).columns
    summary = json.loads(output)
    return judged(columns, records, releases) | {
        "ended": summary["ended"], "misses": summary["timing"]["misses"],
        "stale": sum(summary["bus_faults"].get(n, 0) for n in ("timeout", "corrupt")),
        "dropped": summary["telemetry_drops"], "admitted": max(admitted, default=0),
        "fifo": all(record.privileged for record in records),
    }  # fmt: skip


def judged(
    columns: dict[str, np.ndarray], records: Sequence[ProbeRecord], releases: Releases
) -> dict[str, Any]:
    """Return the longest read, and how many ticks lost time that the host did not take."""
    start_ns = columns["deadline_ns"]
    end_ns = start_ns + columns["lateness_ns"] + columns["busy_ns"]
    long = (columns["read_ns"] > TIMEOUT_NS + LATE_NS) | (columns["missed"] > 0)
    unexplained = [
        int(columns["tick"][k])
        for k in np.flatnonzero(long)
        if not _held_up(int(start_ns[max(k - 1, 0)]), int(end_ns[k]), records, releases)
    ]
    return {
        "ticks": len(start_ns),
        "longest_read_ms": round(float(columns["read_ns"].max()) * 1e-6, 3),
        "longest_tick_ms": round(float(columns["busy_ns"].max()) * 1e-6, 3),
        "latest_ms": round(float(columns["lateness_ns"].max()) * 1e-6, 3),
        "long": int(long.sum()),
        "unexplained": unexplained,
    }


def _held_up(
    start_ns: int, end_ns: int, records: Sequence[ProbeRecord], releases: Releases
) -> bool:
    """Whether a probe or the emulator saw the host stand still in a window."""
    stalled = any(record.stall_ns(start_ns, end_ns)[1] for record in records)
    first, last = np.searchsorted(releases.written_ns, (start_ns, end_ns))
    late = releases.written_ns[first:last] - releases.due_ns[first:last]
    return stalled or bool((late > LATE_NS).any())


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


@contextlib.contextmanager
def _readers(port: int, count: int) -> Iterator[list[int]]:
    """Process with the viewers; yields the numbers of admitted ones that it reports."""
    process = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, "--view", str(port), "--readers", str(count)],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    admitted: list[int] = []

    def listen() -> None:
        for line in process.stdout or ():
            admitted.append(int(line))

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        yield admitted
    finally:
        process.kill()
        thread.join()
        process.wait()


async def _view(port: int, count: int) -> None:
    """Hold connections that read slowly, and say every second how many are admitted."""
    held: set[int] = set()
    tasks = [asyncio.create_task(_slow_reader(port, k, held)) for k in range(count)]
    while tasks:
        print(len(held), flush=True)
        await asyncio.sleep(1.0)


async def _slow_reader(port: int, number: int, held: set[int]) -> None:
    while True:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=_PIECE_BYTES)
            writer.write(_HANDSHAKE.encode())
            if b" 101 " in await reader.readline():
                held.add(number)
                writer.write(_masked(_WISH.encode()))
                while await reader.read(_PIECE_BYTES):
                    await asyncio.sleep(1.0)
            held.discard(number)
            writer.close()
        await asyncio.sleep(1.0)


def _masked(payload: bytes) -> bytes:
    """Text frame of a client, masked with zeros (RFC 6455, section 5.2)."""
    return bytes([0x81, 0x80 | len(payload)]) + bytes(4) + payload


if __name__ == "__main__":
    sys.exit(main())
