"""Next experiment: motions ranked by how well they separate the hypotheses of a diagnosis.

MOTION is a file for 'dropstitch run --motion' and 'dropstitch simulate --motion'; MOTION.html
beside it shows the ranking. With --repeat the motion is run on a rig with hidden effects, and its
trial is diagnosed together with those at hand; both lie in MOTION/trials and MOTION/gap.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from firmware_py.config import read_config
from firmware_py.core.console import DONE, Progress, emit
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import resolved
from firmware_py.safety.limits import Limits
from models.commands.gap_workflow.gap import DIAGNOSIS_FILES
from models.gap.report.gap_json import DiagnosisInputs, GapDocument, read_gap_document
from models.plant.plant import Plant, read_plant
from models.rig.drawn import rig_named
from models.shared.catalogue import parse_strengths
from models.shared.output_paths import check_output_directory, check_output_file
from models.trials.checks.trials import read_usable_trials
from models.trials.files import conditions_beside, write_trial
from models.trials.trial import TrialSet

if TYPE_CHECKING:
    from models.gap.experiment.experiment import Experiment

EXAMPLE = (
    "dropstitch experiment --gap build/gap/gap.json --config robot.toml --out build/motion.toml"
)

LARGEST_SEED: Final = 2**32 - 1


def configure(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--gap", type=Path, required=True, metavar="GAP.json", help="document of the diagnosis")
    add("--config", type=Path, required=True, metavar="ROBOT", help="robot.toml, for its limits")
    add("--out", type=Path, required=True, metavar="MOTION.toml", help="file to write")
    add("--plant", type=Path, metavar="PLANT", help="plant of the diagnosis, where it was moved")
    add(
        "--trials", type=Path, nargs="+", metavar="DIR",
        help="trials of the diagnosis, where they were moved",
    )  # fmt: skip
    add(
        "--payloads", type=float, nargs="+", default=[], metavar="KG",
        help="payloads to choose from (those of the trials, and one that swaps the payload)",
    )  # fmt: skip
    add("--repeat", action="store_true", help="run the motion on a rig and diagnose again")
    add("--rig", default="default", metavar="NAME|TOML", help="with --repeat: the rig (default)")
    add(
        "--hide", action="append", default=[], metavar="EFFECT[:JOINT]=STRENGTH",
        help="with --repeat: effect that the rig has beside its defaults; repeatable",
    )  # fmt: skip
    add("--seed", type=int, default=0, help="with --repeat: of the rig's variation and noise (0)")


def run(args: argparse.Namespace) -> int:
    """Rank the motions and write the best; with --repeat also repeat the diagnosis."""
    _check_options(args)
    document = read_gap_document(args.gap)
    inputs = _inputs(document, args)
    check_output_file(args.out, [Path(inputs.plant)])
    if args.repeat:
        _check_repetition(args.out, args.gap, inputs)
    plant = read_plant(Path(inputs.plant))
    if inputs.plant_sha256 and plant.sha256() != inputs.plant_sha256:
        raise InputError(inputs.plant, "is not the plant of this diagnosis", "give it with --plant")
    trials = _trials(inputs, plant)
    check_output_file(args.out, [conditions_beside(t.path) for t in trials])
    limits = _limits(args.config, trials[0].meta.dof)
    rig = rig_named(args.rig).hide(parse_strengths(args.hide)) if args.repeat else None
    # CasADi and SciPy are loaded here, so that a wrong option is refused at once.
    from models.gap.experiment.experiment import experiment_in_words, rank_motions, write_motion
    from models.gap.experiment.experiment_page import write_experiment_page
    from models.gap.experiment.rival import rivals_of
    from models.rig.protocol import TrialCase, run_case

    progress = Progress("experiment", 0)
    experiment = rank_motions(
        rivals_of(document.hypotheses), plant, trials, limits, args.payloads, progress.step,
        document.settings,
    )  # fmt: skip
    write_motion(experiment.best, args.out)
    page = write_experiment_page(experiment, args.out.with_suffix(".html"))
    result: dict[str, Any] = {"motion": str(args.out), **_result(experiment)}
    text = f"{experiment_in_words(experiment, args.out)}\n{page}"
    if rig is not None:
        case = TrialCase(
            experiment.best.motion, experiment.best.payload_kg, trial=1, seed=args.seed
        )
        write_trial(run_case(rig, case), args.out.with_suffix("") / "trials")
        progress.step("motion run on the rig", 2)
        result["after"], compared = _diagnose_again(args.out, plant, document, inputs, progress)
        text = f"{text}\n{compared}"
    progress.step("done", 0)
    emit(args, result, text)
    return DONE


def _result(experiment: Experiment) -> dict[str, Any]:
    return {
        "hypotheses": {r.label: round(r.probability, 4) for r in experiment.rivals},
        "separation_now": dict(zip(experiment.pairs, experiment.before, strict=True)),
        "ranking": [
            {
                "kind": r.motion.kind,
                "amplitude_rad": r.motion.amplitude_rad,
                "period_s": r.motion.period_s,
                "payload_kg": r.payload_kg,
                "separation": dict(zip(experiment.pairs, r.separations, strict=True)),
                "least_gain": r.least_gain,
            }
            for r in experiment.ranked
        ],
        "together": experiment.together,
    }


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


def _check_repetition(out: Path, gap: Path, inputs: DiagnosisInputs) -> None:
    """Refuse a place where a repetition would replace an input, or mix its trial with others."""
    results, trials = out.with_suffix("") / "gap", out.with_suffix("") / "trials"
    check_output_directory(results, DIAGNOSIS_FILES, [gap, Path(inputs.plant)])
    check_output_directory(trials)
    if trials.exists() and any(trials.iterdir()):
        raise InputError(trials, "is not empty", "remove it, or name another --out")


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


def _diagnose_again(
    out: Path, plant: Plant, before: GapDocument, inputs: DiagnosisInputs, progress: Progress
) -> tuple[dict[str, Any], str]:
    """Diagnose all trials, that of the motion included; the hypotheses before and after."""
    from models.gap.diagnosis import diagnose
    from models.gap.experiment.rival import credible_set, rivals_of
    from models.gap.report.gap_page import write_results

    directories = (*inputs.trials, str(resolved(out.with_suffix("") / "trials")))
    inputs = msgspec.structs.replace(inputs, trials=directories, trials_sha256="")
    trials = _trials(inputs, plant)
    inputs = msgspec.structs.replace(inputs, trials_sha256=trials.content_sha256())
    diagnosis = diagnose(plant, trials, progress.step, settings=before.settings)
    after, page = write_results(diagnosis, inputs, out.with_suffix("") / "gap")
    first, second = (
        {r.label: round(r.probability, 4) for r in credible_set(rivals_of(d.hypotheses))}
        for d in (before, after)
    )
    named = [n.effect for n in after.named]
    words = [
        ", ".join(f"{label} {p:.2f}" for label, p in probabilities.items())
        for probabilities in (first, second)
    ]
    return (
        {"set_before": first, "set_after": second, "named": named, "verdict": after.verdict},
        f"hypotheses that hold 0.95 before: {words[0]}\nafter the motion: {words[1]}\n"
        f"named now: {', '.join(named) or 'nothing'}; verdict {after.verdict}\n{page}",
    )
