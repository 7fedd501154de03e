"""Training of the files that the gap workflow ships; README.md beside it says which makes which."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Final

COMMANDS: Final = {
    "cases": ("tuning_cases", "diagnose data sets with hidden effects, on rigs for tuning"),
    "own-error": ("plant_error", "patterns of the plant's own error, and the null distributions"),
    "answers": ("answer_model", "probabilities of the answers, from such diagnoses"),
    "strengths": ("strengths", "error of each effect's equation, from such diagnoses"),
    "sets": ("weight_fit", "loss of the prior of sets of effects, from such diagnoses"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one of the commands."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] not in COMMANDS:
        print("python -m models.gap.training COMMAND; each has a --help", end="\n\n")
        for name, (_, summary) in COMMANDS.items():
            print(f"  {name:10} {summary}")
        return 0 if arguments in ([], ["--help"], ["-h"]) else 2
    module = import_module(f"models.gap.training.{COMMANDS[arguments[0]][0]}")
    return int(module.main(arguments[1:]))


if __name__ == "__main__":
    sys.exit(main())
