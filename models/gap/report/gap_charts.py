"""Charts of the gap workflow: signals over time, measured and simulated, with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from firmware_py.core.units import TIME, DisplayUnit, si_unit, signal_words
from models.gap.report.gap_json import GapDocument, largest_gaps
from models.gap.report.gap_words import most_improved_signal
from models.plant.identification.evaluation import Comparison, compare_with_trials
from models.plant.plant import Plant
from models.shared.pages import LegendEntry
from models.shared.palette import AFTER, BEFORE, MEASURED, MUTED
from models.trials.trial import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
SHOWN_ROWS: Final = 400
"""Most points of a trace: a screen shows no more."""
MOST_SIGNALS: Final = 4
BEFORE_AND_AFTER: Final = (LegendEntry(BEFORE, "before"), LegendEntry(AFTER, "after"))


@dataclass(frozen=True)
class SignalCurves:
    """Signal of a trial in SI units: measured, and simulated before and after."""

    trial: str
    signal: str
    unit: str
    time_s: Array
    measured: Array
    simulated: tuple[Array, ...]  # Before and after; before alone where the two are equal
    floor: float | None  # Root mean square

    @property
    def errors(self) -> list[Array]:
        """Measured minus simulated."""
        return [self.measured - simulated for simulated in self.simulated]


def signal_curves(
    document: GapDocument, before: Plant, after: Plant, trials: Sequence[Trial]
) -> list[SignalCurves]:
    """Signals with the largest gap, on the trial in which the error of the first one falls most.

    The signal that the headline states comes first.
    """
    errors, first = document.before.held_out, most_improved_signal(document)
    order = sorted(largest_gaps(document.map) or errors, key=lambda s: s != first)
    pairs = list(zip(*(compare_with_trials(p, trials) for p in (before, after)), strict=True))
    both = max(pairs, key=lambda pair: _fall(pair, order))
    trial, measured = both[0].trial, both[0].measured
    end = document.goal_not_followed_at_row.get(trial.name, len(trial))
    result = []
    for signal in [s for s in order if s in measured][:MOST_SIGNALS]:
        simulated = [c.simulated[signal][:end] for c in both]
        result.append(
            SignalCurves(
                trial.name, signal, errors[signal].unit, trial.time_s[:end] - trial.time_s[0],
                measured[signal][:end],
                tuple(simulated[: 1 if np.array_equal(simulated[0], simulated[1]) else 2]),
                document.floor_rms.get(signal),
            )
        )  # fmt: skip
    return result


def _fall(pair: tuple[Comparison, ...], signals: Sequence[str]) -> tuple[float, float]:
    """Fall of the mean squared error from before to after, and the error before."""
    signal = next(s for s in signals if s in pair[0].simulated)
    before, after = (float(np.nanmean(c.error(signal) ** 2)) for c in pair)
    return before - after, before


def draw_signal(
    upper: Any, lower: Any, curves: SignalCurves, unit: DisplayUnit, unit_of_errors: DisplayUnit
) -> None:
    """Draw a signal over time on the upper axes; on the lower ones its errors and noise floor."""
    every = slice(None, None, max(1, len(curves.time_s) // SHOWN_ROWS))
    time_s = curves.time_s[every]
    upper.plot(time_s, unit.shown(curves.measured)[every], color=MEASURED, lw=1.7, label="measured")
    looks = [(entry.colour, entry.label) for entry in BEFORE_AND_AFTER]
    for values, (colour, label) in zip(curves.simulated, looks, strict=False):
        upper.plot(time_s, unit.shown(values)[every], color=colour, lw=1.0, label=label)
    upper.set_ylabel(unit.label(signal_words(curves.signal)))
    upper.yaxis.set_major_locator(MaxNLocator(5))
    if curves.floor is not None:
        floor = unit_of_errors.factor * curves.floor
        lower.axhspan(-floor, floor, color=MUTED, alpha=0.25, lw=0)
    errors = [unit_of_errors.shown(error) for error in curves.errors]
    for error, (colour, _) in zip(errors, looks, strict=False):
        lower.plot(time_s, error[every], color=colour, lw=1.1)
    most = float(np.nanmax(np.abs(errors))) or 1.0
    lower.set(
        xlabel=TIME.label("time"), ylabel=unit_of_errors.label("error"),
        xlim=(0, curves.time_s[-1]), ylim=(-1.08 * most, 1.08 * most),
    )  # fmt: skip
    lower.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))


def plot_signals(
    document: GapDocument, before: Plant, after: Plant, trials: Sequence[Trial]
) -> Figure:
    """Signals with the largest gap over time: measured, simulated before and after, and errors."""
    from matplotlib import pyplot

    from models.shared.drawing import FILE_STYLE

    rows = signal_curves(document, before, after, trials)
    figure: Figure
    with pyplot.rc_context(FILE_STYLE):
        figure, axes = pyplot.subplots(
            2, len(rows), squeeze=False, sharex=True, height_ratios=(3, 2),
            figsize=(3.6 * len(rows), 4.2), layout="constrained",
        )  # fmt: skip
        for (upper, lower), curves in zip(axes.T, rows, strict=True):
            unit = si_unit(curves.unit)
            draw_signal(upper, lower, curves, unit, unit)
        axes[0, 0].legend(fontsize=7)
        band = "; grey: noise floor" if document.floor_rms else ""
        figure.suptitle(f"Trial {rows[0].trial}{band}", fontsize=10)
        pyplot.close(figure)
    return figure
