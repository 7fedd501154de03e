"""Error of the equations of the effects, measured on diagnoses of rigs for tuning.

    python -m models.gap.training cases --rigs drawn_118 … --same-link --out build/tuning_same
    python -m models.gap.training strengths build/tuning_same …

Each rightly named effect has a strength that was found, one that was hidden, and an error by
chance. What they differ by beyond chance is the error of the equation. Its size is fitted by
maximum likelihood for all effects, for those of a port, and for each effect; each is drawn towards
the more general one. The differences have more far outliers than a normal distribution: they are
taken to follow Student's, and what is written is scaled so that 1.96 standard errors hold 95 %.

The strengths of the runs are added to those in `strengths.jsonl`; the same one found again counts.
Written is `models/gap/equation_error.json`. Printed is how many strengths lie in their
95 % interval when their rig is left out. No rig for testing may be among them.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from models.gap.equation_error import PATH, EquationError
from models.gap.training.case_runs import case_results
from models.plant.effects import EFFECTS
from models.rig.drawn import rig_purpose

TABLE: Final = Path(__file__).with_name("strengths.jsonl")

LOG_DEVIATIONS: Final = (0.15, 0.3, 0.5, 0.7, 1.0)
"""Standard deviation of the logarithm of an error around the more general one; the one that
predicts the strengths of rigs left out best is taken."""

DEGREES_OF_FREEDOM: Final = 4.0
"""Of Student's distribution [assumed]."""

HALF_WIDTH: Final = float(student.ppf(0.975, DEGREES_OF_FREEDOM))
"""Of its 95 % interval."""

Z_95: Final = 1.96
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""

LEAST, MOST = 0.003, 1.0
"""Range of the errors, as fractions of the strength."""


class FoundStrength(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Strength of a rightly named effect, in the catalogue's unit."""

    rig: str
    effect: str  # Name in the catalogue
    found: float  # Strength in the plant, and in the rig
    hidden: float
    chance_error: float  # Standard error without that of the equation

    @property
    def hidden_in(self) -> tuple[str, str, float]:
        """Rig, effect and hidden strength: no two data sets share them."""
        return self.rig, self.effect, self.hidden

    @property
    def difference(self) -> float:
        """Between hidden and found strength, as a fraction of the latter."""
        return (self.found - self.hidden) / self.found

    @property
    def chance(self) -> float:
        """Error by chance, as a fraction of the strength."""
        return self.chance_error / abs(self.found)


class FoundDeviation(NamedTuple):
    """Difference of a strength, and its standard error; both as fractions of the strength."""

    difference: float
    standard_error: float

    @property
    def inside(self) -> bool:
        """Whether the hidden strength lies in the 95 % interval."""
        return abs(self.difference) <= Z_95 * self.standard_error

    @property
    def loss(self) -> float:
        """Negative logarithm of the density of Student's distribution."""
        scale = self.standard_error * Z_95 / HALF_WIDTH
        return -float(student.logpdf(self.difference, DEGREES_OF_FREEDOM, scale=scale))


def found_strengths(results: Iterable[dict[str, Any]]) -> list[FoundStrength]:
    """Strengths of the rightly named effects of some results."""
    found = []
    for result in results:
        if result.get("impossible") or result["case"]["kind"] not in ("single", "pair"):
            continue
        for effect, hidden in result["true"].items():
            if estimates := result["estimates"].get(effect):
                value, error, before = estimates[0]
                equation = result["equation_error"][effect] * (value - before)
                chance = float(np.sqrt(max(error**2 - equation**2, 0.0)))
                row = FoundStrength(
                    rig=result["case"]["rig"], effect=effect, found=value - before, hidden=hidden,
                    chance_error=chance,
                )  # fmt: skip
                found.append(row)
    return found


def fitted_error(strengths: Sequence[FoundStrength], log_deviation: float) -> EquationError:
    by_port, by_effect = defaultdict(list), defaultdict(list)
    for strength in strengths:
        by_port[EFFECTS[strength.effect].port].append(strength)
        by_effect[strength.effect].append(strength)
    general = _size(strengths)
    port = {name: _size(rows, general, log_deviation) for name, rows in by_port.items()}
    effect = {
        name: _size(rows, port[EFFECTS[name].port], log_deviation)
        for name, rows in by_effect.items()
    }
    return EquationError(
        strengths=len(strengths),
        general=_written(general),
        port={name: _written(size) for name, size in sorted(port.items())},
        effect={name: _written(size) for name, size in sorted(effect.items())},
    )


def _size(rows: Sequence[FoundStrength], general: float = 0.0, log_deviation: float = 0.0) -> float:
    """Likeliest scale of the differences beyond chance, as a fraction of the strength."""
    difference = np.array([s.difference for s in rows])
    chance = np.array([s.chance for s in rows])

    def loss(logarithm: float) -> float:
        scale = np.hypot(chance, np.exp(logarithm))
        prior = ((logarithm - np.log(general)) / log_deviation) ** 2 / 2 if general else 0.0
        return float(prior - student.logpdf(difference, DEGREES_OF_FREEDOM, scale=scale).sum())

    bounds = float(np.log(LEAST)), float(np.log(MOST))
    return float(np.exp(minimize_scalar(loss, bounds=bounds, method="bounded").x))


def _written(size: float) -> float:
    """Standard error of which 1.96 hold 95 % of Student's distribution of a scale."""
    return round(size * HALF_WIDTH / Z_95, 3)


def deviations_left_out(
    strengths: Sequence[FoundStrength], log_deviation: float
) -> list[FoundDeviation]:
    """Deviation of each strength, by the errors of the other rigs."""
    found = []
    for rig in sorted({s.rig for s in strengths}):
        error = fitted_error([s for s in strengths if s.rig != rig], log_deviation)
        for s in strengths:
            if s.rig == rig:
                standard_error = float(np.hypot(s.chance, error.fraction(s.effect)))
                found.append(FoundDeviation(s.difference, standard_error))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Fit, say how good it is, write."""
    parser = argparse.ArgumentParser(
        prog="python -m models.gap.training strengths",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", type=Path, nargs="*", help="directories of `cases --out`")
    args = parser.parse_args(argv)
    known = msgspec.json.Decoder(FoundStrength).decode_lines(TABLE.read_bytes())
    new = found_strengths(r for run in args.runs for r in case_results(run).values())
    again = {s.hidden_in for s in new}
    strengths = [*(s for s in known if s.hidden_in not in again), *new]
    for rig in sorted({s.rig for s in strengths}):
        if rig_purpose(rig) == "test":
            parser.error(f"{rig} is for testing: nothing is set on it")
    strengths.sort(key=lambda s: (s.effect, s.rig, s.hidden))
    left_out = {
        log_deviation: deviations_left_out(strengths, log_deviation)
        for log_deviation in LOG_DEVIATIONS
    }
    best = min(
        LOG_DEVIATIONS, key=lambda log_deviation: sum(d.loss for d in left_out[log_deviation])
    )
    inside = sum(d.inside for d in left_out[best])
    width = float(np.median([d.standard_error for d in left_out[best]]))
    error = fitted_error(strengths, best)
    print(f"{len(strengths)} strengths of {len({s.rig for s in strengths})} rigs")
    print(f"standard deviation of a logarithm around the more general one: {best:g}")
    print(f"in their 95 % interval, each rig left out in turn: {inside} of {len(strengths)}")
    print(f"median standard error there: {width:.1%} of the strength")
    TABLE.write_bytes(msgspec.json.Encoder().encode_lines(strengths))
    PATH.write_bytes(msgspec.json.format(msgspec.json.encode(error), indent=1))
    return 0
