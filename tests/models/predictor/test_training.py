"""Choice among candidates by payloads and motions left out."""

import numpy as np

from models.predictor.candidates import CorrectedTip, ObserverTip
from models.predictor.training import choose_tip_predictor, group_folds
from tests.models.predictor.cases import made_up_rows


def test_folds_leave_out_each_payload_and_each_motion_or_else_trials():
    rows = made_up_rows()
    folds = group_folds(rows)
    assert len(folds) == 5  # three payloads, two motions
    for train, test in folds:
        assert not set(train) & set(test) and len(train) + len(test) == len(rows)
        new_payload = not {*rows.payload_kg[test]} & {*rows.payload_kg[train]}
        assert new_payload or not {*rows.motion[test]} & {*rows.motion[train]}
    rows = made_up_rows(payloads_kg=(1.0,))
    rows.motion[:] = "sinusoid"
    assert [set(rows.run[test]) for _, test in group_folds(rows)] == [{k} for k in range(6)]


def test_a_correction_is_chosen_where_it_helps_and_none_where_it_does_not():
    rows = made_up_rows()
    corrected, _ = choose_tip_predictor(rows, (ObserverTip, CorrectedTip))
    assert (corrected.candidate.name, corrected.variant) == ("corrected observer", 2)
    exact = rows.take(np.arange(len(rows)))
    exact.tip_m[:] = exact.observer_tip_m + 1e-4 * np.random.default_rng(1).normal(size=(1200, 3))
    plain, (_, other) = choose_tip_predictor(exact, (ObserverTip, CorrectedTip))
    assert plain.candidate.name == "observer"
    assert other.variant == 0


def test_a_link_mounted_askew_shifts_the_tip_in_the_plane_of_a_joint():
    rows, a = made_up_rows(dof=2), 0.005
    angles = [rows.names.index(f"angle_{j}_rad") for j in (1, 2)]
    rows.inputs[:, angles] = 0.0
    rows.tip_m[:] = [0.0, 0.0, 1.0]
    shifts_m = [shift_m[0] for shift_m in rows.with_askew_mount(a).askew_m]
    assert np.allclose(shifts_m, [[-a, 0, 0], [a, 0, 0], [0, -a, 0], [0, a, 0]])
    rows.inputs[:, angles[0]] = np.pi / 2  # the link points along x; plane 1 is x and z
    rows.tip_m[:] = [1.0, 0.0, 0.0]
    shifts_m = [shift_m[0] for shift_m in rows.with_askew_mount(a).askew_m]
    assert np.allclose(shifts_m, [[0, 0, a], [0, 0, -a], [0, -a, 0], [0, a, 0]])
