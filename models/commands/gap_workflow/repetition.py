"""Repetition of a diagnosis with the trial of a recommended motion, run on a rig.

For MOTION.toml the trial lies in MOTION/trials and the diagnosis in MOTION/gap. A later repetition
replaces the trial that the last one wrote; MOTION/trials/written.sha256 tells it from other trials.
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.console import Progress
from firmware_py.errors import InputError
from firmware_py.files.input_files import read_text
from firmware_py.files.output_files import write_whole
from firmware_py.motion import Motion
from models.commands.gap_workflow.gap import DIAGNOSIS_FILES
from models.commands.output_paths import check_output_directory, is_same_file
from models.gap.report.gap_json import DiagnosisInputs, GapDocument, read_gap_document
from models.plant.plant import Plant
from models.rig.parameters import RigParameters
from models.trials.checks.trials import read_usable_trials
from models.trials.files import write_trial
from models.trials.trial import Trial

WRITTEN: Final = "written.sha256"
"""Names and hashes of the files of the last repetition, as `sha256sum` writes them."""


def check_repetition(out: Path, gap: Path, inputs: DiagnosisInputs) -> None:
    """Refuse a place where a repetition would replace an input or files that it did not write.

    `out`: file of the motion; the repetition is written next to it.
    """
    directory = out.with_suffix("")
    results, own = directory / "gap", directory / "trials"
    for place in (results, own):
        check_output_directory(place)
    for written in (results / name for name in DIAGNOSIS_FILES):
        if is_same_file(written, gap) or is_same_file(written, Path(inputs.plant)):
            raise InputError(
                f"--out {out}", f"would replace {written}, which is read", "name another file"
            )
    if any(is_same_file(own, Path(given)) for given in inputs.trials):
        raise InputError(
            f"--out {out}", f"would put a trial into {own}, which is read", "name another file"
        )
    for other in sorted(set(_trial_files(own)) - set(_own_files(own))):
        raise InputError(
            other, "is not as --repeat wrote it", "move it elsewhere, or name another --out"
        )


def _trial_files(directory: Path) -> list[Path]:
    return [*directory.glob("*.csv"), *directory.glob("*.toml")]


def _own_files(directory: Path) -> list[Path]:
    """Files of trials that the last repetition wrote and that are unchanged since."""
    record = directory / WRITTEN
    lines = read_text(record, "remove it").splitlines() if record.exists() else []
    known = {name: sha256 for sha256, _, name in (line.partition("  ") for line in lines)}
    named = (p for p in _trial_files(directory) if p.name in known)
    return [p for p in named if known[p.name] == _sha256(p)]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_own_trial(trial: Trial, directory: Path) -> None:
    """Write the trial of a repetition, replacing that of the last one; other trials are kept."""
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=directory, prefix=".") as scratch:
        samples = write_trial(trial, scratch)
        files = (samples.with_suffix(".toml"), samples)
        record = "".join(f"{_sha256(p)}  {p.name}\n" for p in files)
        for old in _own_files(directory):
            old.unlink()
        # Recorded before they are moved here: an interrupted run leaves no unrecorded files.
        write_whole(directory / WRITTEN, record.encode())
        for path in files:
            path.replace(directory / path.name)


def repeat_diagnosis(
    args: argparse.Namespace, plant: Plant, inputs: DiagnosisInputs,
    recommended: tuple[Motion, float], rig: RigParameters, progress: Progress,
) -> tuple[dict[str, Any], str]:  # fmt: skip
    """Run a motion on the rig, diagnose all trials, and compare the sets of hypotheses."""
    from models.gap.calibration.calibration_files import patterns_beside
    from models.gap.report.diagnosis_files import write_diagnosis
    from models.rig.protocol import TrialCase, run_case

    directory = args.out.with_suffix("")
    motion, payload_kg = recommended
    trial = run_case(rig, TrialCase(motion, payload_kg, trial=1, seed=args.seed))
    own = directory / "trials"
    check_repetition(args.out, args.gap, inputs)
    write_own_trial(trial, own)
    progress.step("motion run on the rig", 2)
    inputs = msgspec.structs.replace(inputs, trials=(*inputs.trials, str(own.resolve())))
    every = read_usable_trials([Path(d) for d in inputs.trials], plant.signals)
    every = every.where(lambda t: t.meta.dof == trial.meta.dof)
    inputs = msgspec.structs.replace(inputs, trials_sha256=every.content_sha256())
    patterns = patterns_beside(Path(inputs.plant), plant.sha256())
    given = read_gap_document(args.gap)
    _, document, page = write_diagnosis(
        plant, every, inputs, directory / "gap", progress.step, patterns=patterns,
        settings=given.settings,
    )  # fmt: skip
    return _compared(given, document, page)


def _compared(given: GapDocument, document: GapDocument, page: Path) -> tuple[dict[str, Any], str]:
    """Result and text: sets of hypotheses before and after, and the effects that are now named."""
    from models.gap.experiment.rival import credible_set, rivals_of

    before = credible_set(rivals_of(given.hypotheses))
    after = credible_set(rivals_of(document.hypotheses))
    result = {
        "set_before": {r.label: round(r.probability, 4) for r in before},
        "set_after": {r.label: round(r.probability, 4) for r in after},
        "named": [n.effect for n in document.named if n.kept],
        "verdict": document.verdict,
    }
    first, second = (
        ", ".join(f"{r.label} {r.probability:.2f}" for r in listed) for listed in (before, after)
    )
    return result, (
        f"hypotheses that hold 0.95 before: {first}\nafter the motion: {second}\n"
        f"named now: {', '.join(result['named']) or 'nothing'}; verdict {document.verdict}\n{page}"
    )
