"""Candidate of one's own: the class of the documentation, from a file outside of the project."""

import re
from pathlib import Path

import pytest

from firmware_py.errors import InputError
from models.predictor.candidates import own_candidate
from models.predictor.learners import CANDIDATES
from models.predictor.training import choose_tip_predictor
from tests.models.predictor.tip_cases import made_up_rows

PAGE = Path(__file__).parents[3] / "docs" / "predictor" / "choice.md"
[CODE] = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_class_of_the_documentation_is_compared_and_chosen_where_it_is_best(tmp_path):
    (tmp_path / "mine.py").write_text(CODE, encoding="utf-8")
    mine = own_candidate(tmp_path / "mine.py", CANDIDATES)
    rows = made_up_rows()
    rows.tip_m[:] += [0.01, 0.0, -0.01]
    choice = choose_tip_predictor(rows, [], (CANDIDATES[0], mine))
    assert choice.chosen.name == "shifted observer"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class A:\n", "does not run (IndentationError"),
        ("1 / 0\n", "does not run (ZeroDivisionError"),
        ("x = 1\n", "has 0 candidates, no class at all"),
        (CODE.replace("def write", "def save"), "ShiftedObserver lacks write"),
        (CODE + CODE.replace("ShiftedObserver", "Other"), "has 2 candidates, not one"),
        (CODE.replace("shifted observer", "observer"), "'observer' as another is"),
        (CODE.replace("(1,)", "()"), "no variant"),
    ],
)
def test_other_files_are_refused_in_one_sentence(text, said, tmp_path):
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        own_candidate(tmp_path / "mine.py", CANDIDATES)
    assert said in str(refusal.value) and "\n" not in str(refusal.value)
