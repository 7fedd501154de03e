"""Calibration of the gap workflow on rigs of drawn structure, without a gap.

    python -m models.gap.training own-error --out build/calibrate

Each rig has its own structure and values (`models.rig.drawn`) and a plant that is identified on
its trials. Then the link's stiffness, mass and damping change a few times, and the nuisance is
refitted. What is left beyond the plant's mean error gives the patterns of its own error
(`models/gap/estimation/model_discrepancy.npz`); a diagnosis on further rigs, with these patterns,
gives the null distribution of every effect (`models/gap/search/null_distribution.json`), the link
that the plant knows among the links. Resumable: files by rig. No rig for testing is among them.
"""

from __future__ import annotations

import argparse
import json
import os
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.console import Progress
from firmware_py.errors import InputError
from firmware_py.motion import Motion
from models.gap.calibration.left_out_rigs import pattern_sentence
from models.gap.calibration.pattern_measurement import (
    PatternWork,
    learned_patterns,
    own_errors_of,
    run_pattern_work,
)
from models.gap.diagnosis import diagnose
from models.gap.estimation.model_discrepancy import read_patterns, write_patterns
from models.gap.search.null_distribution import (
    KEY_ENDS,
    OwnErrorKnown,
    calibrated_null_distribution,
    null_distributions,
)
from models.gap.search.null_distribution import PATH as NULL_DISTRIBUTION
from models.gap.training.case_run import study_trials
from models.gap.training.rig_plants import identification_cases, plant_of_rig, required_noise_floor
from models.plant.plant import read_plant
from models.rig.drawn import FIRST_TEST_NUMBER, drawn_link
from models.rig.protocol import TrialCase
from models.shared.worker_pool import worker_pool
from models.trials.trial import TrialSet

PAYLOADS_KG: Final = (0.0, 0.5, 1.0, 1.5, 2.0)
OTHER_MOTIONS: Final = ("small", "slow", "multisine", "triangle")
"""Names of motions on which a plant of the study's motion was not identified."""


def pattern_work(links: int, directory: Path, joints: int) -> PatternWork:
    """Measurement of the patterns of the study's motion."""
    diagnosed = tuple(TrialCase(Motion(dof=joints), payload_kg, 1) for payload_kg in PAYLOADS_KG)
    own = directory / f"own_error_{joints}dof"
    return PatternWork(identification_cases(joints, "study"), diagnosed, links, own)


def null_case(rig: int, link: int, directory: str, joints: int, known: OwnErrorKnown) -> None:
    """Save the d′ of each effect on one link, and the residual without any.

    `rig`, `link`: numbers of rig and link; the patterns are those of other rigs.
    `known`: what counts as known of the plant's own error; with nothing the motion is one of
    `OTHER_MOTIONS` in turn, with other_payloads the payloads lie between those of the plant.
    """
    path = _null_file(directory, rig, link, joints, known)
    motion = OTHER_MOTIONS[(rig + link) % len(OTHER_MOTIONS)] if known == "nothing" else "study"
    try:
        plant = read_plant(plant_of_rig(f"drawn_{rig}", Path(directory) / "plants", joints))
        payloads = "between" if known == "other_payloads" else "study"
        trials = study_trials(drawn_link(rig, link), link_seed(rig, link), joints, motion, payloads)
    except InputError:
        path.write_text("{}", encoding="utf-8")
        return
    floor = required_noise_floor(plant, joints) if known == "curves" else None
    found = diagnose(plant, TrialSet(tuple(trials)), floor=floor)
    separations = dict(found.screened)
    for effect, separation in found.refitted.items():
        separations[effect] = max(separations[effect], separation)
    row = {
        "separations": separations, "left": found.residual_before, "named": found.named,
        "change": found.link_change, "motion": motion,
        "verdict": found.verdict,
    }  # fmt: skip
    path.write_text(json.dumps(row), encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """Draw, run, and write both files."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training own-error",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, help="directory of results")
    parser.add_argument(
        "--rigs",
        type=int,
        default=22,
        help="drawn rigs for the patterns; 0 keeps those in use",
    )
    parser.add_argument("--first", type=int, help="first rig of the null distribution (RIGS)")
    parser.add_argument("--null", type=int, default=18, help="further rigs for the null")
    parser.add_argument("--links", type=int, default=3, help="other links of each rig")
    parser.add_argument("--joints", type=int, choices=(1, 2), default=1, help="driven joints")
    parser.add_argument(
        "--known", choices=KEY_ENDS, default="patterns",
        help="what is known of the plant's own error on the trials of the null distribution "
        "(patterns; with --rigs 0 less)",
    )  # fmt: skip
    args = parser.parse_args(argv)
    first = args.rigs if args.first is None else args.first
    if max(args.rigs, first + args.null) > FIRST_TEST_NUMBER:
        parser.error(f"rigs from drawn_{FIRST_TEST_NUMBER} on are for testing: take fewer")
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    args.out.mkdir(parents=True, exist_ok=True)
    if args.rigs:
        write_shipped_patterns(pattern_work(args.links, args.out, args.joints), range(args.rigs))
    others = range(first, first + args.null)
    write_null_distribution(others, range(args.links + 1), str(args.out), args.joints, args.known)
    return 0


def write_shipped_patterns(work: PatternWork, rigs: Sequence[int]) -> None:
    """Measure the patterns of a motion, and put them in the place of those that are shipped."""
    progress = Progress("own error", len(rigs))
    with worker_pool(2) as pool:
        run_pattern_work(work, rigs, pool, progress.step)
    files = [work.file(k) for k in rigs]
    for key, own in own_errors_of(files).items():
        print(f"{key}: {pattern_sentence(own)}")
    learned = {p.key: p for p in learned_patterns(files)}
    write_patterns([*learned.values(), *(p for p in read_patterns() if p.key not in learned)])


def write_null_distribution(
    rigs: Sequence[int], links: Sequence[int], directory: str, joints: int, known: OwnErrorKnown
) -> None:
    """Diagnose links without an effect; write the null distribution of a number of joints.

    `rigs`, `links`: numbers; link 0 is the one that the plant knows.
    """
    work = [(k, n, directory, joints, known) for n in links for k in rigs]
    files = [_null_file(directory, k, n, joints, known) for k, n, *_ in work]
    _run(null_case, [w for w, f in zip(work, files, strict=True) if not f.exists()])
    rows = [r for r in (json.loads(f.read_text(encoding="utf-8")) for f in files) if r]
    found = calibrated_null_distribution(
        [r["separations"] for r in rows], [r["left"] for r in rows], [r["change"] for r in rows]
    )
    tables, key = null_distributions(), f"{joints}{KEY_ENDS[known]}"
    pooled = tables.get(key, tables[str(joints)]).repetitions_pooled  # as in the search just made
    tables[key] = msgspec.structs.replace(found, repetitions_pooled=pooled)
    NULL_DISTRIBUTION.write_bytes(
        msgspec.json.format(msgspec.json.encode(tables), indent=1) + b"\n"
    )


def link_seed(rig: int, link: int) -> int:
    """Seed of the trials of a link: no two links share noise."""
    return zlib.crc32(f"drawn_{rig}, link {link}".encode())


def _null_file(directory: str, rig: int, link: int, joints: int, known: OwnErrorKnown) -> Path:
    suffix = ("" if joints == 1 else f"_{joints}dof") + KEY_ENDS[known].replace(" ", "_")
    return Path(directory) / f"null_{rig}_{link}{suffix}.json"


def _run(job: Callable[..., None], work: Sequence[tuple[Any, ...]]) -> None:
    """Do what is missing, on two processors."""
    progress = Progress("own error", len(work))
    with worker_pool(2) as pool:
        futures = [pool.submit(job, *arguments) for arguments in work]
        for future in as_completed(futures):
            future.result()
            progress.step(job.__name__)
