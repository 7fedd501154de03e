"""Calibration of the gap workflow for one's own trials: patterns of the plant's own error.

Draws rigs of other structure, runs the motions and payloads of the trials on them, identifies a
plant on each and changes its link: what the plants then miss without any hidden effect belongs to
the noise floor. Writes PLANT.calibration/patterns.npz, which `gap` takes from there. It can be
stopped: a rerun goes on with what is missing.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from firmware_py.core.console import DONE, emit
from firmware_py.core.errors import InputError
from models.gap.calibration.files import begin_work, patterns_file
from models.plant.identification.doubts import SAME_SIZE_FRACTION, refuse_other_links
from models.plant.plant import read_plant
from models.rig.drawn import rig_named
from models.rig.parameters import RigParameters
from models.shared.missing_files import make_missing
from models.trials.checks.trials import read_usable_trials
from models.trials.trial import TrialSet

EXAMPLE = "dropstitch calibrate build/trials --plant build/plant.json"

COUNTS: Final = {
    "rigs": (12, 2, "drawn rigs"),
    "links": (3, 1, "changed links of each rig"),
    "workers": (2, 1, "processes that work at once"),
}
"""Options that are counts: default, least value, and help."""


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "trials", type=Path, nargs="+", metavar="DIR", help="trials that the plant is identified on"
    )
    parser.add_argument(
        "--plant", type=Path, required=True, metavar="PLANT", help="plant that was identified"
    )
    parser.add_argument("--link", type=Path, help="description of the link, where not the study's")
    for name, (value, _, help_text) in COUNTS.items():
        parser.add_argument(f"--{name}", type=int, default=value, help=f"{help_text} ({value})")


def run(args: argparse.Namespace) -> int:
    for name, (_, least, _) in COUNTS.items():
        if getattr(args, name) < least:
            raise InputError(f"--{name}", f"is {getattr(args, name)}", f"give {least} or more")
    plant = read_plant(args.plant)
    if plant.load != "link":
        raise InputError(
            str(args.plant), f"has the load {plant.load!r}, and only links are drawn",
            "run gap without a calibration",
        )  # fmt: skip
    trials = read_usable_trials(args.trials, plant.signals)
    make = _make(args.link, trials)
    refuse_other_links(plant, args.plant, trials)
    # CasADi and MuJoCo are loaded here, so that a wrong option is refused at once.
    from models.gap.calibration.measurement import (
        PatternWork,
        learned_patterns,
        own_errors_of,
        pattern_sentence,
    )
    from models.gap.calibration.trials import protocol_of
    from models.gap.estimation.own_error import write_patterns
    from models.gap.estimation.transfer import motion_of
    from models.gap.residuals.localisation import motion_in_words

    cases, path = protocol_of(trials), patterns_file(args.plant)
    work = PatternWork(cases, cases, args.links, path.parent, make, plant)
    begin_work(work.fingerprint(), plant.sha256(), path.parent)
    jobs = work.jobs(range(args.rigs))
    make_missing("calibrate", jobs, args.workers)
    measured = own_errors_of(list(jobs))
    write_patterns(learned_patterns(measured), path)
    motions = {motion_of(key): pattern_sentence(rigs) for key, rigs in measured.items()}
    lines = [f"{motion_in_words(motion)}: {sentence}" for motion, sentence in motions.items()]
    emit(args, {"patterns": str(path), "motions": motions}, "\n".join([*lines, str(path)]))
    return DONE


def _make(link: Path | None, trials: TrialSet) -> RigParameters:
    """Rig around which others are drawn; refused if a trial has another size of link."""
    make = rig_named("default" if link is None else str(link))
    for trial in trials:
        sizes = {"length": trial.meta.link_length_m, "width": trial.meta.link_width_m}
        for name, size_m in sizes.items():
            drawn_m = make[f"link.{name}_m"]
            if abs(size_m - drawn_m) > SAME_SIZE_FRACTION * drawn_m:
                raise InputError(
                    trial.name, f"has a link {name} of {size_m:g} m, the drawn rigs {drawn_m:g} m",
                    "describe the link with --link LINK.toml",
                )  # fmt: skip
    return make
