"""The figures that documentation and README state, measured in one run of one commit.

    make figures                    # everything; writes docs/figures.md, docs/figures.json, README
    make figures ONLY="tip loop"    # these parts; prints them and writes nothing
    python -m bench.figures --readme   # the block of README, from docs/figures.json

What a part needs of build/ is made first, as `make demo` and `make study` make it. A part that
fails says so in its row; the pages are written at the end. Leave the machine alone meanwhile: some
parts measure times.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import datetime
import io
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from dropstitch.__main__ import main as dropstitch
from firmware_py.core.console import DONE, NEGATIVE, Progress
from firmware_py.core.errors import InputError

ROOT: Final = Path(__file__).parents[1]
BUILD: Final = Path("build")
OUT: Final = BUILD / "figures"
"""What the parts write; each part begins with an empty directory."""
PAGE, DOCUMENT, README = ROOT / "docs/figures.md", ROOT / "docs/figures.json", ROOT / "README.md"
BLOCK: Final = re.compile(r"(<!-- figures -->\n).*?(<!-- /figures -->)", re.DOTALL)

DATA: Final = Path(os.environ.get("DROPSTITCH_DATA", "../shared/data"))
"""Recordings of other machines (docs/gap/real-data.md)."""
GAP_RIGS: Final = ("drawn_1200", "drawn_1201", "drawn_1202")
"""Rigs for testing."""
SIMULATION, MACHINE = "simulation", "this machine"
README_FIGURES: Final = ("plan-2dof", "tip-2dof", "gap-class-changed", "real-xl330", "loop-misses")


@dataclass(frozen=True)
class Figure:
    """One row; `value` is in the unit as shown, `shown` has its digits."""

    name: str
    what: str
    value: float
    shown: str
    beside: str
    measured_on: str
    command: str


class Part(NamedTuple):
    """What measures some figures, what it needs of build/, and its title on the page."""

    title: str
    measure: Callable[[Path], list[Figure]]
    needs: tuple[str, ...] = ()


def plant(out: Path) -> list[Figure]:
    """Tip of the identified plant on trials that no fit used."""
    rows = []
    for motion, words in (("20deg", "a 20° amplitude"), ("multisine", "a multisine")):
        by_dof = _read(BUILD / f"study/evaluate_unseen_{motion}.json")["dof"]
        for dof in ("1", "2"):
            rms_mm, rigid_mm = (1e3 * by_dof[dof][k] for k in ("tip_rms_m", "rigid_tip_rms_m"))
            rows.append(Figure(
                f"plant-{motion}-{dof}dof",
                f"RMS tip error of the identified plant on {words} that was not fitted, {dof}DOF",
                rms_mm, f"{rms_mm:.2f} mm", f"a rigid link: {rigid_mm:.0f} mm", SIMULATION,
                f"make build/study/evaluate_unseen_{motion}.json",
            ))  # fmt: skip
    return rows


def estimator(out: Path) -> list[Figure]:
    """What the estimated deformation index is worth beside the true one."""
    rows = []
    for dof in (1, 2):
        study = _read(BUILD / f"study/bundle_{dof}dof/study.json")
        percent = 100 * study["estimators"]["unseen_20deg"]["observer"]["benefit_recovered"]["3"]
        rows.append(Figure(
            f"estimator-{dof}dof",
            "accuracy gained with the estimated DI, as a fraction of that gained with the true DI, "
            f"20° amplitude outside the training data, {dof}DOF",
            percent, f"{percent:.0f} %", "cubic polynomial", SIMULATION,
            f"make build/study/bundle_{dof}dof/observer.fmu",
        ))  # fmt: skip
    return rows


def tip(out: Path) -> list[Figure]:
    """The robot's predictor in its loop."""
    from bench import tip as bench

    rows = []
    for dof in (1, 2):
        measured = bench.measure(BUILD / f"bundle_{dof}dof", ["multisine"], "default")
        errors = measured["multisine"]["deployed"]["all"]
        paper_mm = 1e3 * measured["multisine"]["paper's polynomial"]["all"]["mean_m"]
        mean_mm, percent = 1e3 * errors["mean_m"], 100 * errors["coverage"]
        on, command = SIMULATION, f"python -m bench.tip build/bundle_{dof}dof"
        rows += [
            Figure(
                f"tip-{dof}dof",
                "mean error of the tip predicted in the loop, rig with unseen motion, payload "
                f"(1.3 kg) and link, {dof}DOF",
                mean_mm, f"{mean_mm:.2f} mm", f"the paper's polynomial: {paper_mm:.2f} mm", on,
                command,
            ),
            Figure(
                f"tip-coverage-{dof}dof",
                f"samples of that run inside the 95 % prediction interval, {dof}DOF",
                percent, f"{percent:.1f} %", f"n = {errors['rows']} ticks of one run", on, command,
            ),
        ]  # fmt: skip
    return rows


def onnx(out: Path) -> list[Figure]:
    """Time of one prediction beside other ways to run the same model."""
    from bench import onnx as bench

    cases, rows = bench.measure_all(1200), []
    for slow, words in (("default", "skl2onnx's conversion"), ("sklearn", "scikit-learn")):
        r = bench.ratio(cases, slow, "deployed")
        rows.append(Figure(
            f"onnx-{slow}", f"speed of one prediction, the bundle's ONNX graph against {words}",
            r["mean"], f"{r['mean']:.1f} × faster",
            f"{len(cases)} models: {r['least']:.1f} to {r['most']:.1f} ×", MACHINE,
            "python -m bench.onnx",
        ))  # fmt: skip
    return rows


def loop(out: Path) -> list[Figure]:
    """Own work and own misses of the loop in real time."""
    _quietly("sil", "--bundle", str(BUILD / "bundle_2dof"), "--fmu",
             str(BUILD / "twin_2dof.fmu"), "--line", "socket", "--seconds", "60",
             "--out", str(out))  # fmt: skip
    timing = _read(out / "timing.json")
    p50_us, p99_us = (timing["own_cost"][f"p{q}_ns"] / 1e3 for q in (50, 99))
    bound = 100 * timing["own_miss_rate_upper_bound_95"]
    by_host = timing["misses"] - timing["own_misses"]
    early = "" if timing["run"]["ended"] == "finished" else f"; it ended early: {timing['reason']}"
    command = "make figures ONLY=loop"
    return [
        Figure("loop-own", "computing time of a 17 ms tick in real time, p99, 2DOF", p99_us,
               f"{p99_us:.0f} µs", f"p50 {p50_us:.0f} µs, {timing['slots']} ticks", MACHINE,
               command),
        Figure("loop-misses", "deadlines missed by the loop itself, 2DOF",
               timing["own_misses"], f"{timing['own_misses']} of {timing['slots']}",
               f"miss rate below {bound:.2g} % at 95 % confidence; {by_host} by the host{early}",
               MACHINE, command),
    ]  # fmt: skip


def sdk(out: Path) -> list[Figure]:
    """The loop beside the same loop on the Dynamixel SDK."""
    from bench import sdk_loop
    from firmware_py.bus.servo_models import model_named
    from firmware_py.inference.bundle import ModelBundle

    setting = sdk_loop.Setting(
        ModelBundle.load(BUILD / "bundle_2dof"), BUILD / "twin_2dof.fmu",
        model_named(sdk_loop.MODEL), 8.0, 0.01, 1, out,
    )  # fmt: skip
    rows = sdk_loop.measure(setting, 2)
    peer, ours = rows["SDK"], rows["ours, socket"]
    percent = 100 * peer["missed_slots"] / peer["slots"]
    return [Figure(
        "sdk", "deadlines missed by the same loop on the Dynamixel SDK as shipped, 1 % of the "
        "replies lost, one core under load",
        percent, f"{percent:.1f} % of {peer['slots']}",
        f"this loop: {100 * ours['missed_slots'] / ours['slots']:.1f} % of {ours['slots']}; the "
        f"SDK with real-time rights: {100 * rows['SDK, FIFO']['missed_slots'] / peer['slots']:.1f} "
        "%", MACHINE,
        "python -m bench.sdk_loop --bundle build/bundle_2dof --fmu build/twin_2dof.fmu",
    )]  # fmt: skip


def faults(out: Path) -> list[Figure]:
    """The fault campaign."""
    _quietly("faults", "--bundle", str(BUILD / "bundle_2dof"), "--fmu",
             str(BUILD / "twin_2dof.fmu"), "--out", str(out))  # fmt: skip
    counts = _read(out / "faults.json")["counts"]
    of = sum(counts.values())
    return [Figure("faults", "fault cases with the reaction that the fault table requires",
                   counts["pass"], f"{counts['pass']} of {of}",
                   f"{counts['fail']} failed, {counts['inconclusive']} inconclusive",
                   SIMULATION, "make faults")]  # fmt: skip


def fmu(out: Path) -> list[Figure]:
    """A step of the exported twin, and its two interface types."""
    from bench.fmu_host import measure

    hosted = {dof: measure(BUILD / "plant.json", dof) for dof in (1, 2)}
    rows = []
    for dof, result in hosted.items():
        checked = _quietly("fmu", "check", str(BUILD / f"twin_{dof}dof.fmu"), "--json")
        step_us = json.loads(checked)["step_us"]["bare"]
        rows.append(Figure(
            f"fmu-step-{dof}dof", f"a step of 17 ms of the twin FMU in FMPy, {dof}DOF", step_us,
            f"{step_us:.0f} µs",
            f"in a C host, inputs and outputs included: {result['step_us']:.1f} µs", MACHINE,
            f"python -m bench.fmu_host --dof {dof}",
        ))  # fmt: skip
    exchange_nm = 1e9 * max(result["exchange_m"] for result in hosted.values())
    rows.append(Figure(
        "fmu-exchange",
        "tip in Model Exchange (CVode, 1e-9) beside Co-Simulation, largest distance",
        exchange_nm, f"{exchange_nm:.0f} nm", "10 s, 1DOF and 2DOF", SIMULATION,
        "python -m bench.fmu_host --dof 2",
    ))  # fmt: skip
    return rows


def real(out: Path) -> list[Figure]:
    """Recordings of other machines, with a part left out that the plant then predicts."""
    from bench.real import run_systems

    rows = []
    words = {
        "xl330_pendulum": ("real-xl330", "XL330 servo with a pendulum (Rhoban/bam)",
                           "Coulomb and viscous friction"),
        "emps": ("real-emps", "EMPS, a car on a ball screw (Janot et al.)",
                 "the published friction and offset"),
        "flexible_link": ("real-flexible", "flexible link (Quanser)", "no further effect"),
    }  # fmt: skip
    for system, result in run_systems(list(words), DATA, out).items():
        name, machine, reference = words[system]
        named = " + ".join(e for round_ in result["rounds"] for e in round_)
        rows.append(Figure(
            name, f"{machine}: error on held-out recordings with the effects named by `gap`, "
            "relative to " + reference,
            result["ratio"], f"{result['ratio']:.2f}", f"named: {named}",
            f"{result['recordings']} recordings", f"python -m bench.real DATA --only {system}",
        ))  # fmt: skip
    return rows


def gap(out: Path) -> list[Figure]:
    """Effects hidden in rigs for testing."""
    from bench.gap import figures_by_link
    from models.gap.training.case_runs import records_of, run_cases
    from models.gap.training.cases import hidden_cases

    # One effect in three data sets of each rig, nothing in one; no pairs, none outside.
    cases = [
        case for same in (False, True) for rig in GAP_RIGS
        for case in hidden_cases(rig, 3, 0, 1, 0, 0, 65, same)
    ]  # fmt: skip
    failed = run_cases(cases, out)
    by_link = figures_by_link(records_of(cases, out))
    on = f"simulation, {len(GAP_RIGS)} rigs for testing"
    command = "python -m bench.gap --rigs " + " ".join(GAP_RIGS)
    rows = []
    for name, link, words in (
        ("changed", "link changed", "link changed since identification"),
        ("same", "same link", "link unchanged"),
    ):
        for rate, what in (
            ("class", f"hidden effects named correctly, or by a declared look-alike, {words}"),
            ("false", f"false alarms: a gap is reported where nothing is hidden, {words}"),
        ):
            counts = by_link[link]["class_right" if rate == "class" else "false_alarms"]
            if not counts["of"]:
                continue
            percent = 100 * counts["fraction"]
            low, high = (100 * x for x in counts["interval"])
            rows.append(Figure(
                f"gap-{rate}-{name}", what, percent,
                f"{round(counts['fraction'] * counts['of'])} of {counts['of']}",
                f"{percent:.0f} %, 95 % interval {low:.0f} to {high:.0f} %"
                + (f"; {failed} data sets failed" if failed else ""), on, command,
            ))  # fmt: skip
    return rows


def plans(out: Path) -> list[Figure]:
    """The tip on a path, beside goals of rigid kinematics."""
    from bench.plans import measure

    rows = []
    for dof in (1, 2):
        cases = measure(BUILD, [dof])
        worst = max(cases, key=lambda case: case["unknown_m"])
        rms_mm, known_mm, rigid_mm = (1e3 * worst[f"{k}_m"] for k in ("unknown", "known", "rigid"))
        path = "line" if dof == 1 else "circle"
        rows.append(Figure(
            f"plan-{dof}dof",
            f"RMS distance of the tip from a planned {path}, payload estimated, {dof}DOF",
            rms_mm, f"{rms_mm:.1f} mm",
            f"rigid kinematics: {rigid_mm:.0f} mm; payload known: {known_mm:.1f} mm", SIMULATION,
            "python -m bench.plans",
        ))  # fmt: skip
    return rows


def link(out: Path) -> list[Figure]:
    """A link that the program was not made for."""
    held_out = _read(BUILD / "link_demo/plant.json")["provenance"]["held_out"]
    ratio = held_out["rigid_tip_rms_m"] / held_out["tip_rms_m"]
    return [Figure(
        "link", "another link (0.6 m, 12 markers, XM430, hanging): tip error of a rigid link over "
        "that of the identified plant, held-out trials", ratio, f"{ratio:.1f} ×",
        f"{1e3 * held_out['tip_rms_m']:.2f} mm", SIMULATION, "make link-demo",
    )]  # fmt: skip


def campaign(out: Path) -> list[Figure]:
    """Throughput of a campaign on both executors, and what a case costs beside its run."""
    rows = []
    for executor, words in (("processes", "two processes"), ("dask", "a dask cluster of two")):
        start_s = time.monotonic()
        _quietly("campaign", "docs/campaigns/payload-and-loss.toml", "--workers", "2",
                 "--executor", executor, "--out", str(out / executor))  # fmt: skip
        wall_s = time.monotonic() - start_s
        with (out / executor / "costs.csv").open(encoding="utf-8", newline="") as file:
            runs_s = [float(row["wall_s"]) for row in csv.DictReader(file)]
        percent = 100 * (2 * wall_s / sum(runs_s) - 1)
        rows.append(Figure(
            f"campaign-{executor}",
            f"a campaign of {len(runs_s)} runs of 10 s in software on {words}", wall_s,
            f"{wall_s:.0f} s", f"{percent:.1f} % beside the runs, with start and page", MACHINE,
            "make figures ONLY=campaign",
        ))  # fmt: skip
    return rows


def image(out: Path) -> list[Figure]:
    """The robot's package."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(out)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = out.glob("*.whl")
    kb = wheel.stat().st_size / 1e3
    seconds = []
    for _ in range(7):
        start_s = time.perf_counter()
        subprocess.run([sys.executable, "-m", "dropstitch", "--help"], cwd=ROOT, check=True,
                       capture_output=True)  # fmt: skip
        seconds.append(time.perf_counter() - start_s)
    ms = 1e3 * min(seconds)
    return [
        Figure("image-help", "start of `dropstitch --help`", ms, f"{ms:.0f} ms",
               "best of 7 fresh processes", MACHINE, "make figures ONLY=image"),
        Figure("image-wheel", "the robot's wheel", kb, f"{kb:.0f} kB", "", MACHINE,
               "make figures ONLY=image"),
    ]  # fmt: skip


BUNDLES: Final = ("build/bundle_1dof/observer.fmu", "build/bundle_2dof/observer.fmu")
PARTS: Final = {
    "loop": Part("The loop in real time", loop, ("build/twin_2dof.fmu",)),
    "sdk": Part("Beside the Dynamixel SDK", sdk, ("build/twin_2dof.fmu",)),
    "onnx": Part("Prediction", onnx),
    "fmu": Part("FMUs", fmu, ("build/twin_1dof.fmu", "build/twin_2dof.fmu")),
    "image": Part("The robot's package", image),
    "plant": Part("Plant", plant, (
        "build/study/evaluate_unseen_20deg.json", "build/study/evaluate_unseen_multisine.json",
    )),
    "estimator": Part("Deformation index without motion capture", estimator, (
        "build/study/bundle_1dof/observer.fmu", "build/study/bundle_2dof/observer.fmu",
    )),
    "tip": Part("Predicted tip", tip, BUNDLES),
    "plans": Part("Tip on a path", plans, BUNDLES),
    "link": Part("Another link", link, ("build/link_demo/plant.json",)),
    "gap": Part("Hidden effects", gap),
    "real": Part("Recordings of other machines", real),
    "campaign": Part("Campaigns", campaign, BUNDLES[:1]),
    "faults": Part("Faults", faults, ("build/twin_2dof.fmu",)),
}  # fmt: skip
"""In the order of measuring; those that measure times come first."""
READING: Final = ("plant", "estimator", "tip", "plans", "gap", "real", "link", "loop", "sdk",
                  "faults", "onnx", "fmu", "campaign", "image")  # fmt: skip
"""Order of the page."""


def measure_parts(names: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of each part, or the error that ended it."""
    _make([need for name in names for need in PARTS[name].needs])
    figures, progress = [], Progress("figures", len(names))
    for name in names:
        out, start_s = OUT / name, time.monotonic()
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        progress.begin(name)
        row: dict[str, Any] = {"part": name, "title": PARTS[name].title, "figures": []}
        try:
            row["figures"] = [asdict(figure) for figure in PARTS[name].measure(out)]
        except (Exception, SystemExit) as error:
            traceback.print_exc()
            row["error"] = f"{type(error).__name__}: {error}".splitlines()[0]
        figures.append(row | {"seconds": round(time.monotonic() - start_s, 1)})
        progress.step(name)
    return sorted(figures, key=lambda row: READING.index(row["part"]))


def measured_by() -> dict[str, Any]:
    """Commit and machine of a run."""
    cpu = platform.machine()
    with contextlib.suppress(OSError):
        names = re.findall(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
        cpu = names[0] if names else cpu
    changed = _git("status", "--porcelain", "--untracked-files=no")
    return {
        "commit": _git("rev-parse", "--short=10", "HEAD"),
        "uncommitted_changes": bool(changed),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "cpu": cpu,
        "cores": os.cpu_count(),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }


def page_text(document: dict[str, Any]) -> str:
    """Text of docs/figures.md."""
    by = document["measured_by"]
    changes = ", with uncommitted changes" if by["uncommitted_changes"] else ""
    lines = [
        "# Figures", "",
        "Written by `make figures`; do not edit. All figures are of one run of one commit. "
        "`make figures ONLY=PART` measures a part again and writes nothing.", "",
        f"Commit {by['commit']}{changes}, {by['date']}. {by['cpu']}, {by['cores']} cores, "
        f"{by['kernel']}, Python {by['python']}. \"This machine\" is that one; \"simulation\" does "
        "not depend on it.", "",
        "| figure | value | beside it, or n | measured on | command |",
        "|---|---|---|---|---|",
    ]  # fmt: skip
    for part in document["parts"]:
        error = ""
        if "error" in part:
            error = f" Not measured: {part['error']} (`make figures ONLY={part['part']}`)."
        lines.append(f"| **{part['title']}** |{error} | | | |")
        for f in part["figures"]:
            cells = (f["what"], f["shown"], f["beside"], f["measured_on"], f"`{f['command']}`")
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def readme_block(document: dict[str, Any]) -> str:
    """Table that README shows: five of the figures."""
    rows = {f["name"]: f for part in document["parts"] for f in part["figures"]}
    by = document["measured_by"]
    machine = f"{by['cpu']}, {by['cores']} cores"
    lines = ["| figure | value | measured on |", "|---|---|---|"]
    for name in README_FIGURES:
        if name in rows:
            f = rows[name]
            beside = f" ({f['beside']})" if f["beside"] else ""
            on = machine if f["measured_on"] == MACHINE else f["measured_on"]
            lines.append(f"| {f['what']} | {f['shown']}{beside} | {on} |")
    return "\n".join(lines) + "\n"


def with_block(readme: str, document: dict[str, Any]) -> str:
    """README with its block of figures renewed."""
    return BLOCK.sub(lambda m: m[1] + readme_block(document) + m[2], readme)


def write_pages(document: dict[str, Any]) -> None:
    """Write page, document and README's block, each at once."""
    texts = {
        DOCUMENT: json.dumps(document, indent=1, ensure_ascii=False) + "\n",
        PAGE: page_text(document),
        README: with_block(README.read_text(encoding="utf-8"), document),
    }
    for path, text in texts.items():
        fresh = path.with_suffix(".part")
        fresh.write_text(text, encoding="utf-8")
        fresh.replace(path)


def _quietly(*arguments: str) -> str:
    """Output of a command of this project; verdicts (exit codes 1 and 3) are no errors."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        code = dropstitch(list(arguments))
    if code not in (0, 1, 3):
        raise RuntimeError(f"{arguments[0]} ended with exit code {code}")
    return out.getvalue()


def _make(files: Sequence[str]) -> None:
    """Make what is missing of build/; what cannot be made fails the part that reads it."""
    if files:
        environment = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL")}
        command = ["make", "--no-print-directory", "--keep-going", "--jobs", "2"]
        subprocess.run([*command, *dict.fromkeys(files)], cwd=ROOT, env=environment, check=False,
                       stdout=sys.stderr)  # fmt: skip


def _check_build_is_of_this_commit() -> None:
    """Refuse a full run on files that an earlier commit made."""
    committed_s = int(_git("log", "-1", "--format=%ct"))
    for need in dict.fromkeys(need for part in PARTS.values() for need in part.needs):
        path = ROOT / need
        if path.exists() and path.stat().st_mtime < committed_s:
            raise InputError(need, "is older than the commit", "make clean, then make figures")


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print or write."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.figures", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--only", nargs="+", choices=PARTS, metavar="PART",
                        help="print these parts, write nothing: " + " ".join(PARTS))  # fmt: skip
    parser.add_argument("--readme", action="store_true", help="print the block of README")
    args = parser.parse_args(argv)
    if args.readme:
        print(readme_block(_read(DOCUMENT)), end="")
        return DONE
    os.chdir(ROOT)
    if not args.only:
        try:
            _check_build_is_of_this_commit()
        except InputError as error:
            print(error, file=sys.stderr)
            return 2
    document: dict[str, Any] = {"measured_by": measured_by()}
    document["parts"] = measure_parts(args.only or list(PARTS))
    for part in document["parts"]:
        print(f"{part['title']} ({part['seconds']:.0f} s)")
        if "error" in part:
            print(f"  not measured: {part['error']}")
        for f in part["figures"]:
            print(f"  {f['shown']:16} {f['what']} ({f['beside']})")
    if not args.only:
        write_pages(document)
    return NEGATIVE if any("error" in part for part in document["parts"]) else DONE


if __name__ == "__main__":
    sys.exit(main())
