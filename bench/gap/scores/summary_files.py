"""Files of a summary: figures, those by rig, confusion matrices and the reliability diagram."""

from __future__ import annotations

import json
from pathlib import Path

from bench.gap.bench_kind import bench_results
from bench.gap.scores.confusion_matrix import confusion_counts, confusion_matrix_svg
from bench.gap.scores.reliability import WORDS, reliability_svg
from bench.gap.scores.rig_table import Figures, figures_by_rig, rig_table_text
from bench.gap.scores.score_summary import benchmark_figures
from models.rig.drawn_rig import rig_purpose


def write_bench_summary(directory: Path) -> tuple[Figures, dict[str, Figures]]:
    """Write the summary of a run to its folder `summary`; return figures and those by rig."""
    figures, by_rig = benchmark_figures(directory), figures_by_rig(directory)
    results = list(bench_results(directory).values())
    bins = {p: by_rig[of]["reliability"] for p in WORDS if (of := f"all for {p}") in by_rig}
    texts = {
        "figures.json": json.dumps(figures, indent=1) + "\n",
        "by_rig.json": json.dumps(by_rig, indent=1) + "\n",
        "by_rig.md": rig_table_text(by_rig) + "\n",
        "confusion.svg": confusion_matrix_svg(confusion_counts(results)),
        "reliability.svg": reliability_svg(bins),
    }
    for purpose, words in WORDS.items():
        of_purpose = [r for r in results if rig_purpose(r["case"]["rig"]) == purpose]
        if cells := confusion_counts(of_purpose):
            texts[f"confusion_{purpose}.svg"] = confusion_matrix_svg(cells, words)
    summary = directory / "summary"
    summary.mkdir(exist_ok=True)
    for name, text in texts.items():
        (summary / name).write_text(text, encoding="utf-8")
    return figures, by_rig
