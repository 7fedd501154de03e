"""Training of the robot's tip predictor: rows of all training motions, choice, tests, document."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from firmware_py.display_units import FRACTION, LENGTH
from models.learning.onnx_power import to_onnx
from models.plant.simulation.compiled_model import CompiledModel
from models.tip.candidates.candidate_list import CANDIDATES
from models.tip.guarded_tip import GuardedTip
from models.tip.latency import graph_latency
from models.tip.observed_trials import ASKEW_RAD, WRONG_STIFFNESS, observe, wrong_stiffness
from models.tip.predictors_document import CandidateEntry, PredictorsDocument, TipScore
from models.tip.tip_predictor import TipPredictor
from models.tip.tip_rows import TipRows, collect_rows
from models.tip.tip_selection import CandidateResult, TipChoice, choose_tip_predictor, score_tip
from models.trials.trial import Trial, TrialSet

__all__ = ["TipTraining", "train_tip"]


@dataclass(frozen=True)
class TipTraining:
    """Fitted predictor of the robot, its training rows, and the comparison of candidates."""

    predictor: GuardedTip
    rows: TipRows
    document: PredictorsDocument


def train_tip(
    training: Sequence[Trial],
    tests: Mapping[str, TrialSet],
    observer: CompiledModel,
    candidates: Sequence[type[TipPredictor]] = CANDIDATES,
    progress: Callable[[str], None] = lambda detail: None,
    askew_rad: float = ASKEW_RAD,
) -> TipTraining:
    """Choose, fit and test the robot's tip predictor.

    `askew_rad`: angle by which the link may be mounted askew, which the interval covers.
    """
    rows = collect_rows(observe(observer, training))
    changed = {factor: wrong_stiffness(observer.model, factor) for factor in WRONG_STIFFNESS}
    wrong = {factor: changes for factor, changes in changed.items() if changes}
    disturbed = [collect_rows(observe(observer, training, changes)) for changes in wrong.values()]
    choice = choose_tip_predictor(rows, disturbed, candidates, progress, askew_rad)
    seen = {name: collect_rows(observe(observer, trials)) for name, trials in tests.items()}
    if together := [trial for trials in tests.values() for trial in trials]:
        seen |= {
            f"stiffness_x_{factor:g}": collect_rows(observe(observer, together, changes))
            for factor, changes in wrong.items()
        }
    document = PredictorsDocument(
        schema=PredictorsDocument.VERSION,
        dof=rows.dof,
        chosen=choice.chosen.name,
        reason=_reason(choice),
        trials=tuple(t.name for t in training),
        motions=tuple(sorted({t.meta.motion for t in training})),
        payload_kg=tuple(sorted({t.meta.payload_kg for t in training})),
        askew_rad=askew_rad,
        candidates={result.name: _entry(result, seen) for result in choice.candidates},
    )
    return TipTraining(choice.chosen.predictor, rows, document)


def _entry(result: CandidateResult, tests: Mapping[str, TipRows]) -> CandidateEntry:
    graph = to_onnx(result.predictor, len(result.predictor.names)).SerializeToString()
    return CandidateEntry(
        summary=result.summary,
        variant=result.variant,
        nested=result.nested,
        tests={name: _by_part(result.predictor, rows) for name, rows in tests.items()},
        graph_bytes=len(graph),
        latency=graph_latency(graph),
    )


def _by_part(predictor: GuardedTip, rows: TipRows) -> dict[str, TipScore]:
    scores = {"all": score_tip(predictor, rows)}
    for part in ("rest", "motion"):
        if (own := rows.part == part).any():
            scores[part] = score_tip(predictor, rows.take(own))
    return scores


def _covered(score: TipScore) -> str:
    mean = f"{FRACTION.number(score.coverage, 1)} %"
    return f"{mean} ({FRACTION.number(score.coverage_least, 1)} % on the worst axis)"


def _reason(choice: TipChoice) -> str:
    chosen = choice.chosen
    others = ", ".join(
        f"{result.name} {LENGTH.number(result.nested.mean_m, 2)}"
        for result in choice.candidates
        if result is not chosen
    )
    return (
        f"On payloads and motions left out {chosen.summary} is off by "
        f"{LENGTH.number(chosen.nested.mean_m, 2)} mm on average and its interval covers "
        f"{_covered(chosen.nested)}; no candidate that is less simple is "
        f"better by more than 3 % ({others} mm)."
    )
