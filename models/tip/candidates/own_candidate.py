"""Your own candidate: a class in a file outside of the project."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Final, cast

from firmware_py.errors import InputError
from firmware_py.files.input_files import read_text
from models.tip.tip_predictor import TipPredictor

__all__ = ["own_candidate"]

MEMBERS: Final = ("name", "summary", "variants", "fit", "predict", "write")
REMEDY: Final = 'write it as docs/predictor/choice.md shows, "A predictor of one\'s own"'


def own_candidate(path: Path, others: Sequence[type[TipPredictor]]) -> type[TipPredictor]:
    """Run a Python file and return the one candidate that it defines."""
    text = read_text(path, REMEDY)
    module = ModuleType(f"own_candidate_{path.stem}")
    sys.modules[module.__name__] = module  # dataclasses look their module up
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except Exception as error:
        cause = f"{type(error).__name__}: {error}"
        raise InputError(path, f"does not run ({cause})", REMEDY) from error
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
    ]
    whole = [value for value in found if all(hasattr(value, member) for member in MEMBERS)]
    if len(whole) != 1:
        raise InputError(path, f"has {len(whole)} candidates, {_lack(found, whole)}", REMEDY)
    candidate = cast(type[TipPredictor], whole[0])
    if candidate.name in {other.name for other in others}:
        raise InputError(path, f"names its candidate {candidate.name!r} as another is", REMEDY)
    if not candidate.variants:
        raise InputError(path, f"gives {candidate.name!r} no variant", REMEDY)
    return candidate


def _lack(found: Sequence[type], whole: Sequence[type]) -> str:
    """Reason why the classes of a file are not one candidate."""
    if whole:
        return "not one"
    if not found:
        return "no class at all"
    lacking = [member for member in MEMBERS if not hasattr(found[-1], member)]
    return f"{found[-1].__name__} lacks {', '.join(lacking)}"
