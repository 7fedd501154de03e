"""Design of the next experiment: the motion that separates the hypotheses of a diagnosis best.

MOTION is a file for 'dropstitch run --motion' and 'dropstitch simulate --motion'; MOTION.html
beside it shows goals and separation. With --repeat the motion is run on a rig with hidden effects,
and its trial is diagnosed together with those at hand; both lie in MOTION/trials and MOTION/gap.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.config import read_config
from firmware_py.console import DONE, Progress, emit
from firmware_py.errors import InputError
from firmware_py.safety.limits import Limits
from models.commands.gap_workflow.repetition import check_repetition, repeat_diagnosis
from models.commands.output_paths import check_output_file
from models.gap.report.gap_json import DiagnosisInputs, GapDocument, read_gap_document
from models.plant.plant import Plant, read_plant
from models.rig.parameters import read_rig
from models.shared.catalogue import parse_strengths
from models.trials.checks.trials import read_usable_trials
from models.trials.files import conditions_beside
from models.trials.trial import TrialSet

EXAMPLE = (
    "dropstitch experiment --gap build/gap/gap.json --config robot.toml --seconds 10 "
    "--out build/motion.toml"
)

LARGEST_SEED: Final = 2**32 - 1


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--gap", type=Path, required=True, metavar="GAP.json", help="document of the diagnosis")
    add("--config", type=Path, required=True, metavar="ROBOT", help="robot.toml, for its limits")
    add("--seconds", type=float, default=10.0, help="duration of the motion (10)")
    add("--out", type=Path, required=True, metavar="MOTION.toml", help="file to write")
    add("--plant", type=Path, metavar="PLANT", help="plant of the diagnosis, where it was moved")
    add(
        "--trials", type=Path, nargs="+", metavar="DIR",
        help="trials of the diagnosis, where they were moved",
    )  # fmt: skip
    add(
        "--payloads", type=float, nargs="+", default=[], metavar="KG",
        help="payloads to choose from (lightest and middle of the trials)",
    )  # fmt: skip
    add("--seed", type=int, default=0, help="of the random starts, and of the rig (0)")
    add("--repeat", action="store_true", help="run the motion on a rig and diagnose again")
    add("--rig", default="default", metavar="NAME|TOML", help="with --repeat: the rig (default)")
    add(
        "--hide", action="append", default=[], metavar="EFFECT[:JOINT]=STRENGTH",
        help="with --repeat: effect that the rig has beside its defaults; repeatable",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Design and write the motion; with --repeat also repeat the diagnosis."""
    _check_options(args)
    document = read_gap_document(args.gap)
    inputs = _inputs(document, args)
    check_output_file(args.out, [Path(inputs.plant)])
    if args.repeat:
        check_repetition(args.out, args.gap, inputs)
    plant = read_plant(Path(inputs.plant))
    if inputs.plant_sha256 and plant.sha256() != inputs.plant_sha256:
        raise InputError(inputs.plant, "is not the plant of this diagnosis", "give it with --plant")
    trials = _trials(inputs, plant)
    check_output_file(args.out, [conditions_beside(t.path) for t in trials])
    limits = _limits(args.config, trials.trials[0].meta.dof)
    rig = read_rig(args.rig).hide(parse_strengths(args.hide)) if args.repeat else None
    # CasADi and SciPy are loaded here, so that a wrong option is refused at once.
    from models.gap.calibration.calibration_files import patterns_beside
    from models.gap.experiment.experiment import (
        design_experiment,
        experiment_in_words,
        write_motion,
    )
    from models.gap.experiment.experiment_page import write_experiment_page
    from models.gap.experiment.rival import rivals_of

    progress = Progress("experiment", 0)
    found = design_experiment(
        rivals_of(document.hypotheses), plant, trials, limits, args.seconds, args.payloads,
        args.seed, progress.step, document.settings,
        patterns_beside(Path(inputs.plant), plant.sha256()),
    )  # fmt: skip
    write_motion(found.design.document, args.out)
    page = write_experiment_page(found, args.out.with_suffix(".html"))
    best, (motion, payload_kg) = found.best_fixed, found.recommended
    result: dict[str, Any] = {
        "motion": str(args.out),
        "name": found.design.document.name,
        "payload_kg": found.design.document.payload_kg,
        "hypotheses": {r.label: round(r.probability, 4) for r in found.rivals},
        "pairs": [
            {"pair": found.label(k), "before": q.before, "designed": q.separation}
            for k, q in enumerate(found.design.pairs)
        ],
        "least_gain": found.least_gain(found.design.pairs),
        "least_gain_of_best_fixed": found.least_gain(best.pairs) if best else None,
        "recommended": {"motion": motion.name, "payload_kg": payload_kg},
        "together": found.together(),
    }
    text = f"{experiment_in_words(found, args.out)}\n{page}"
    if rig is not None:
        after, repeated = repeat_diagnosis(args, plant, inputs, found.recommended, rig, progress)
        result["after"] = after
        text = f"{text}\n{repeated}"
    progress.step("done", 0)
    emit(args, result, text)
    return DONE


def _check_options(args: argparse.Namespace) -> None:
    """Refuse options that contradict each other, are out of range or would overwrite an input."""
    if args.hide and not args.repeat:
        raise InputError("--hide", "is given without --repeat", "add --repeat, or leave it out")
    if not 0 <= args.seed <= LARGEST_SEED:
        raise InputError(f"--seed {args.seed}", "is out of range", f"choose 0 to {LARGEST_SEED}")
    if args.out.suffix.lower() != ".toml":
        raise InputError(f"--out {args.out}", "is no TOML file", "let its name end with .toml")
    read = [args.config, args.gap, *([Path(args.rig)] if args.repeat else [])]
    check_output_file(args.out, read)


def _limits(path: Path, dof: int) -> Limits:
    """Limits of the diagnosed robot."""
    robot = read_config(path)
    if robot.dof != dof:
        raise InputError(
            path, f"has {robot.dof} servos, the trials of the diagnosis have {dof}",
            "give the configuration of that robot",
        )  # fmt: skip
    return robot.limits_in_force


def _inputs(document: GapDocument, args: argparse.Namespace) -> DiagnosisInputs:
    """Files of the diagnosis; options override those in the document."""
    known = document.inputs or DiagnosisInputs("", "", ())
    if args.plant is not None:
        known = msgspec.structs.replace(known, plant=str(args.plant))
    if args.trials:
        known = msgspec.structs.replace(known, trials=tuple(str(d) for d in args.trials))
    if not known.plant or not known.trials:
        raise InputError(
            args.gap, "does not name its plant and its trials", "give --plant and --trials"
        )
    return known


def _trials(inputs: DiagnosisInputs, plant: Plant) -> TrialSet:
    """Trials of the diagnosis, checked by their hash."""
    trials = read_usable_trials([Path(d) for d in inputs.trials], plant.signals)
    if inputs.dof is not None:
        trials = trials.where(lambda t: t.meta.dof == inputs.dof)
    if inputs.trials_sha256 and trials.content_sha256() != inputs.trials_sha256:
        where = ", ".join(inputs.trials)
        raise InputError(where, "are not the trials of this diagnosis", "give them with --trials")
    return trials
