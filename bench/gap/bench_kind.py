"""Kind of cases for `hil.campaign`: one case of the benchmark, and the results of a run of them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

from bench.gap.cases import BenchCase
from hil.campaign.case_task import canonical_json
from hil.campaign.kinds.case_kind import CaseConfig, CaseContext, CaseKind
from hil.campaign.result_store import CaseRecord, ResultStore

MODULE = "bench.gap.bench_kind"


class BenchConfig(CaseConfig, frozen=True, kw_only=True):
    """Configuration: a case and the plant that it is diagnosed with."""

    plant: str
    case: BenchCase
    sealed: bool = True  # Whether the improved plant is tested on sealed trials
    # File of the patterns of the plant's own error; those shipped where it is empty
    patterns: str = ""


class BenchKind(CaseKind[BenchConfig]):
    """Cases of the benchmark."""

    name: ClassVar[str] = "gap benchmark"
    config: ClassVar[type[BenchConfig]] = BenchConfig
    rooms: ClassVar[tuple[str, ...]] = (
        "firmware_py", "models", "hil/campaign/kinds", "bench/gap",
    )  # fmt: skip

    def files(self, config: BenchConfig) -> dict[str, str]:
        """See `CaseKind.files`."""
        found = {"plant": config.plant}
        return found | ({"patterns": config.patterns} if config.patterns else {})

    def run(self, config: BenchConfig, context: CaseContext) -> dict[str, Any]:
        """See `CaseKind.run`."""
        from bench.gap.case_run import run_bench_case  # loads CasADi and MuJoCo
        from models.gap.estimation.model_discrepancy import read_patterns
        from models.plant.plant import read_plant

        plant = read_plant(config.plant)
        patterns = read_patterns(Path(config.patterns)) if config.patterns else ()
        return run_bench_case(config.case, plant, context.parts_s, config.sealed, patterns)


KIND = BenchKind()


def bench_results(directory: Path) -> dict[str, dict[str, Any]]:
    """Results of a run of the benchmark by key, each with its case and its times.

    Of a case that ran again with other code, or another plant, the latest result counts.
    """
    store = ResultStore(directory)
    times = {row["key"]: json.loads(row["parts_s"]) for row in store.read_costs()}
    files = (directory / "results").rglob("*.json")
    latest: dict[str, CaseRecord] = {}
    for path in sorted(files, key=lambda p: (p.stat().st_mtime_ns, p.name)):
        if (record := store.read(path.stem)) is not None:
            latest[canonical_json(record.config["case"])] = record
    return {
        record.key: {"case": record.config["case"], **record.result, **times.get(record.key, {})}
        for record in latest.values()
    }


def cases_of_run(directory: Path) -> list[BenchCase]:
    """Cases whose results are in a directory."""
    return [BenchCase(**r["case"]) for r in bench_results(directory).values()]


def bench_configuration(
    case: BenchCase, plant: Path, sealed: bool = True, patterns: Path | None = None
) -> dict[str, Any]:
    """Plain configuration of a case."""
    return {
        "plant": str(plant), "case": asdict(case), "sealed": sealed,
        "patterns": "" if patterns is None else str(patterns),
    }  # fmt: skip
