"""Blocks of time of a single trial: what they hold, and which plants have them."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from models.gap.residuals.time_blocks import BLOCKS, in_time_blocks, is_time_block
from models.gap.search.held_out import held_out_folds
from models.plant.plant import NOMINAL, read_plant
from models.trials.trial import Trial, TrialMeta, TrialSet

EXAMPLES = NOMINAL.parent / "examples"
ROWS = 2401


@pytest.fixture
def recording():
    """Trial of a car whose position is a sinusoid."""
    time_s = 0.01 * np.arange(ROWS)
    columns = {"time_s": time_s, "command_1_v": np.cos(time_s), "position_1_m": np.sin(time_s)}
    meta = TrialMeta(dof=1, payload_kg=0.0, trial=1, motion="reference", source="measured",
                     period_s=24.0, rest_samples=1)  # fmt: skip
    return Trial("run", meta, columns)


def test_the_blocks_are_the_recording_in_order_and_each_is_left_out_once(recording):
    blocks = in_time_blocks(read_plant(EXAMPLES / "emps.toml"), TrialSet((recording,)))
    assert len(blocks) == BLOCKS
    for name, column in recording.columns.items():
        assert np.array_equal(np.concatenate([b.columns[name] for b in blocks]), column)
    assert all(is_time_block(b) for b in blocks) and not is_time_block(recording)
    assert len({b.meta.motion for b in blocks}) == len({b.name for b in blocks}) == len(blocks)
    ((what, folds),) = held_out_folds(blocks.trials).items()
    assert what == "blocks of time"
    assert [sorted(fold) for fold in folds] == [[k] for k in range(len(blocks))]


def test_a_recording_is_not_cut_where_it_need_not_or_cannot_be(recording):
    car = read_plant(EXAMPLES / "emps.toml")
    other = replace(recording, meta=msgspec.structs.replace(recording.meta, motion="other"))
    two = TrialSet((recording, other))
    assert in_time_blocks(car, two) is two
    short = {name: column[:900] for name, column in recording.columns.items()}
    few = TrialSet((replace(recording, columns=short),))
    assert in_time_blocks(car, few) is few
    held = TrialSet((recording,))
    pendulum = read_plant(EXAMPLES / "xl330_pendulum.toml")
    assert in_time_blocks(pendulum, held) is held


def test_rows_are_left_out_where_a_single_trial_is_not_cut(recording):
    ((what, folds),) = held_out_folds((recording,)).items()
    assert what == "blocks of time"
    assert np.array_equal(sum(fold[0] for fold in folds), np.ones(ROWS))
