"""Table of the candidates in the report."""

from hil.report.study.candidate_table import candidate_table
from models.predictor.document import CandidateEntry, Latency, PredictorsDocument, TipScore

LATENCY = Latency(1e-5, 3e-5)


def score(mean_m):
    return TipScore(100, mean_m, 2 * mean_m, 3 * mean_m, 0.96, 0.004, 0.9, 2.5 * mean_m, 0.94)


def test_every_candidate_and_test_has_a_row_and_the_chosen_one_says_so():
    entries = {
        name: CandidateEntry(name, 0, score(m), {"trial_2": {"all": score(2 * m)}}, 8000, LATENCY)
        for name, m in (("observer", 0.001), ("paper polynomial", 0.004))
    }
    document = PredictorsDocument(
        schema=1, dof=1, chosen="observer", reason="It is the best.", trials=("a",),
        motions=("sinusoid",), payload_kg=(1.0,), candidates=entries, askew_rad=0.005,
    )  # fmt: skip
    table = candidate_table({1: document})
    assert len(table.rows) == 4 and all(len(row) == len(table.header) for row in table.rows)
    assert table.rows[0][:3] == ["1DOF, observer, chosen", "left out in turn", "1.0"]
    assert table.rows[2][0] == "1DOF, paper polynomial" and table.rows[3][2] == "8.0"
    assert "It is the best." in table.note
