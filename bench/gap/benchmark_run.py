"""Run of the benchmark's cases, as a campaign: what has a valid result is kept."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bench.gap.bench_kind import KIND, MODULE, bench_configuration
from bench.gap.cases import BenchCase
from bench.gap.rig_plants import patterns_of_protocol, plants_of_rigs
from hil.campaign.campaign_cases import CaseMaker
from hil.campaign.campaign_run import RunCounts, run_campaign_cases
from hil.campaign.engines.engine import Engine
from hil.campaign.engines.process_engine import ProcessEngine
from hil.campaign.result_store import ResultStore


def run_benchmark(
    cases: Iterable[BenchCase],
    plant: Path | None,
    out: Path,
    engine: Engine | None = None,
    sealed: bool = True,
    calibration_rigs: int = 0,
    plant_motion: str = "",
) -> RunCounts:
    """Run cases that have no valid result.

    `plant`: identified without effects; None for one of each case's own rig.
    `calibration_rigs`: drawn rigs on which patterns are measured for each motion but the study's;
    zero for none.
    `plant_motion`: name of the motion that plants are identified on; empty for that of each case.
    """
    wanted, store = list(cases), ResultStore(out)
    robot_of = lambda c: (c.rig, c.joints, plant_motion or c.motion)  # noqa: E731
    robots = sorted({robot_of(c) for c in wanted})
    plants = (
        dict.fromkeys(robots, plant)
        if plant is not None
        else plants_of_rigs(robots, out / "plants")
    )
    patterns = {
        protocol: patterns_of_protocol(out / "calibration", calibration_rigs, *protocol)
        for protocol in sorted({(c.joints, c.motion) for c in wanted})
        if calibration_rigs and protocol[1] != "study"
    }
    maker = CaseMaker(KIND, MODULE, store.shared)
    made = maker.cases(
        (
            bench_configuration(c, plants[robot_of(c)], sealed, patterns.get((c.joints, c.motion)))
            for c in wanted
        ),
        "bench.gap",
    )
    made.sort(key=lambda c: c.key)  # a run that is stopped leaves a fair sample
    with store.locked():
        return run_campaign_cases(made, maker, store, engine or ProcessEngine(2, out / "logs"))
