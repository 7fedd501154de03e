"""Patterns learned from the files by rig, and what they leave on rigs left out."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.motion import Motion
from models.gap.calibration.measurement import (
    PatternWork,
    learned_patterns,
    left_out_residuals,
    measure_own_error,
    own_errors_of,
    pattern_sentence,
    trials_without_scatter,
)
from models.rig.drawn import drawn_link
from models.rig.protocol import TrialCase

SIGNALS, SIZE, LINKS = ("angle_1_rad", "tip_x_m"), 40, 3
PAYLOADS_KG = np.array([0.0, 1.0])


def write_rig(path, rng, shapes, key="1dof sinusoid"):
    """Errors of given shapes and of one that no other rig has, each link's amplitude drawn anew."""
    own = 0.3 * rng.standard_normal((1, *shapes.shape[1:]))
    shapes = np.concatenate([shapes, own])
    rows = np.tensordot(rng.standard_normal((LINKS, len(shapes))), shapes, 1)
    np.savez(
        path, key_0=key, payload_kg_0=PAYLOADS_KG, signals_0=np.array(SIGNALS), rows_0=rows,
        noise_0=np.ones((len(SIGNALS), SIZE)),
    )  # fmt: skip


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(0)
    shapes = 3 * rng.standard_normal((2, len(PAYLOADS_KG), len(SIGNALS), SIZE))
    paths = [tmp_path / f"own_error_{k}.npz" for k in range(8)]
    for path in paths:
        write_rig(path, rng, shapes)
    return paths


def test_what_rigs_have_in_common_is_taken_away_on_a_rig_left_out(files):
    (rigs,) = own_errors_of(files).values()
    without, with_patterns = (np.mean(left_out_residuals(rigs, n)) for n in (0, 48))
    own = 0.3**2 / (1 + 1 / 2)  # the floor holds the noise of the mean curve of two trials as well
    assert without > 10 * own
    assert own / 4 < with_patterns < 2 * own
    assert "24 links of 8 rigs" in pattern_sentence(rigs)


def test_patterns_keep_motion_payloads_and_signals(files):
    (patterns,) = learned_patterns(own_errors_of(files))
    assert (patterns.key, patterns.signals) == ("1dof sinusoid", SIGNALS)
    assert patterns.payload_kg.tolist() == PAYLOADS_KG.tolist()


def test_rigs_whose_link_folds_are_passed_over_unless_all_do(files, tmp_path):
    folded = tmp_path / "own_error_9.npz"
    np.savez(folded, reason="the link folds 3.1 s after power-up")
    (before,), (after,) = (learned_patterns(own_errors_of(f)) for f in (files, [folded, *files]))
    assert np.array_equal(before.table, after.table)
    with pytest.raises(InputError, match=r"no drawn rig.*folds 3\.1 s.*less payload"):
        own_errors_of([folded])


@pytest.mark.parametrize("damage", ["empty", "cut"])
def test_a_damaged_file_is_told_with_a_remedy(damage, files):
    if damage == "cut":
        files[3].write_bytes(files[3].read_bytes()[:-300])
    else:
        np.savez(files[3])
    with pytest.raises(InputError, match=r"own_error_3\.npz.*calibrate again"):
        own_errors_of(files)


def test_a_rig_whose_link_folds_leaves_the_reason_alone(tmp_path):
    cases = (TrialCase(Motion(period_s=1.0), 30.0, 1),)
    work = PatternWork(cases, cases, 1, tmp_path)
    measure_own_error(work, 0)
    with pytest.raises(InputError, match="the link folds"):
        own_errors_of([work.file(0)])


def test_trials_without_scatter_repeat_and_differ_from_link_to_link():
    case = TrialCase(Motion(amplitude_rad=0.2, period_s=1.0), 1.0, 1, seed=3)
    (first,) = trials_without_scatter(drawn_link(5, 0), [case])
    (again,) = trials_without_scatter(drawn_link(5, 0), [replace(case, seed=4)])
    (other,) = trials_without_scatter(drawn_link(5, 1), [case])
    assert np.array_equal(first.current_a, again.current_a)
    # The camera's clock starts anywhere within a frame.
    assert first.tip_m == pytest.approx(again.tip_m, abs=1e-4)
    assert np.abs(other.tip_m - first.tip_m).max() > 1e-3
