"""Results of a run in software: timing document, trial and picture."""

from __future__ import annotations

import msgspec

from firmware_py.goals.plan_goals import payload_beyond_plan
from firmware_py.goals.tip_plan import TipPlan
from firmware_py.safety.states import SafetyState
from firmware_py.summary import Ended
from hil.sil.move_figures import move_figures
from hil.sil.path_error import path_errors, tip_of_runs_m
from hil.sil.prediction_error import prediction_error
from hil.sil.reference_jitter import ReferenceJitter
from hil.sil.sil_loop import SilResult
from hil.sil.sil_options import SilOptions, programme_s
from hil.sil.sil_picture import draw_summary
from hil.sil.sil_trial import as_trial
from hil.sil.tick_budget import measure_budget, plan_times
from hil.sil.timing_document import MoveFigures, RunFacts, TimingDocument, write_timing
from hil.sil.timing_verdict import judge_timing, timing_junit
from models.trials.files import write_trial


def write_results(result: SilResult, options: SilOptions) -> TimingDocument:
    """Judge a run and write all results except the log, which the recorder writes."""
    out = options.out
    timing = timing_document(result, options)
    write_timing(out / "timing.json", timing)
    facts = msgspec.to_builtins(timing.environment)
    (out / "timing.xml").write_bytes(timing_junit(timing, facts))
    if result.link and timing.prediction_error.n:
        write_trial(as_trial(result, options), out / "trial")
    draw_summary(result, timing, out / "summary.svg")
    return timing


def timing_document(result: SilResult, options: SilOptions) -> TimingDocument:
    """Judge a run and return the contents of `timing.json`."""
    summary, programme = result.summary, programme_s(options)
    stopped = summary.reason if summary.ended is Ended.TRIPPED else ""
    verdict = judge_timing(
        result.records, options.period_s, result.loop_cpu, result.line_cpu,
        result.outcome.releases, stopped, summary.faults, _interrupted(result, options),
        1.0 if options.line == "virtual" else options.miss_rate,
    )  # fmt: skip
    reference, plan = ReferenceJitter.of_probe(result.loop_cpu), plan_times(result.plan)
    return TimingDocument(
        **msgspec.structs.asdict(verdict),
        environment=result.environment,
        run=RunFacts(
            ended=summary.ended.value,
            reason=summary.reason,
            wall_s=result.wall_s,
            bus_faults=summary.bus_faults,
            faults_injected=result.outcome.faults,
            telemetry_drops=summary.telemetry_drops,
            programme_s=programme,
            feedback=summary.feedback,
            payload_note=_payload_note(result, options),
            out_of_range=summary.out_of_range,
            out_of_range_reasons=result.out_of_range,
        ),
        reference_jitter=reference,
        bus_plan=plan,
        account=measure_budget(result.records, options.period_s, plan, reference),
        prediction_error=prediction_error(result.records, result.outcome.truth, programme),
        path_errors=path_errors(result.records, result.outcome.truth, options.plan)
        if options.plan
        else (),
        moves=_moves(result, options.plan) if options.plan else (),
    )


def _interrupted(result: SilResult, options: SilOptions) -> str:
    """Sentence on a signal that ended the run early, with the slots completed by then; or ""."""
    summary = result.summary
    if summary.ended is not Ended.SIGNALLED:
        return ""
    in_motion = result.records["state"] < SafetyState.STOPPING
    ran = max(int(result.records["tick"][in_motion].max(initial=-1)) + 1, 0)
    return f"{summary.reason} ended the run after {ran} of {options.slots} slots"


def _payload_note(result: SilResult, options: SilOptions) -> str:
    told_kg = options.payload_kg if options.payload_known else None
    return payload_beyond_plan(options.plan, told_kg, result.summary) if options.plan else ""


def _moves(result: SilResult, plan: TipPlan) -> tuple[MoveFigures, ...]:
    runs = tip_of_runs_m(result.records, result.outcome.truth, plan)
    return move_figures(runs[-1], plan) if len(runs) else ()
