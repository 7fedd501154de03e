"""Patterns of the plant's own error: found in noise, whitened away, absent where not measured."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from firmware_py.core.errors import InputError
from models.gap.calibration.measurement import PATTERNS
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.noise_floor import NoiseFloor
from models.gap.estimation.own_error import (
    ModelDiscrepancy,
    patterns_for,
    patterns_of,
    read_patterns,
    write_patterns,
)
from models.gap.settings import DEFAULT_SETTINGS, GapSettings
from models.plant.identification.noise_floor import TrialGroup, coefficient_count, trial_group_key
from models.plant.plant import read_plant

COUNT, STEP_S = 200, 0.017
SIZE = coefficient_count(COUNT, STEP_S)
MOST = PATTERNS
PAYLOADS_KG = np.array([0.0, 1.0])


@pytest.fixture
def trials(make_trial):
    return [make_trial(np.zeros(COUNT), payload_kg=p, trial=n) for p in (0.0, 1.0) for n in (1, 2)]


@pytest.fixture
def group(trials):
    return TrialGroup(trial_group_key(trials[0]), (0, 1, 2, 3), ("x",), SIZE)


def planted(rng, links=60, sizes=(30.0, 15.0)):
    """Two patterns, each link's amplitude drawn anew."""
    patterns = np.linalg.qr(rng.standard_normal((2 * SIZE, len(sizes))))[0].T
    rows = (rng.standard_normal((links, len(sizes))) * sizes) @ patterns
    return patterns, rows.reshape(links, 2, 1, SIZE)


def test_planted_patterns_are_found_with_their_size():
    patterns, rows = planted(np.random.default_rng(0))
    found = patterns_of(rows, np.ones((1, SIZE)), MOST).reshape(MOST, -1)
    sizes = np.linalg.norm(found, axis=1)
    assert sizes[:2] == pytest.approx([30.0, 15.0], rel=0.35)
    assert sizes[2:].max() < 1e-9
    for k in (0, 1):
        assert abs(found[k] @ patterns[k]) / sizes[k] > 0.98


def test_an_error_of_a_signal_with_less_noise_comes_first():
    rows = np.zeros((2, 1, 2, SIZE))
    rows[0, 0, 0, 3], rows[1, 0, 1, 5] = 2.0, 1.0
    noise = np.stack([np.full(SIZE, 100.0), np.ones(SIZE)])
    first, second = patterns_of(rows, noise, 2)
    assert abs(first[0, 1, 5]) == pytest.approx(1 / np.sqrt(2))
    assert abs(second[0, 0, 3]) == pytest.approx(2 / np.sqrt(2))
    assert len(patterns_of(rows, noise, 48)) == 2


def test_rows_follow_the_payload_and_vanish_for_another_motion(trials, group):
    table = np.stack([np.full((1, SIZE), 1.0), np.full((1, SIZE), 3.0)])[None]
    known = ModelDiscrepancy(group.key, PAYLOADS_KG, ("x",), table)
    assert known.rows(group, trials)[0, :, 0, 0].tolist() == [1.0, 1.0, 3.0, 3.0]
    other = TrialGroup("another", group.trials, group.signals, SIZE)
    assert not known.rows(other, trials).any()
    assert not known.rows(TrialGroup(group.key, group.trials, ("y",), SIZE), trials).any()


@dataclass
class Still:
    """Residuals that are never simulated."""

    plant: object
    trials: list
    groups: list
    fit_parameters: tuple = ()
    settings: GapSettings = DEFAULT_SETTINGS

    def as_counted(self, group, spectra):
        return spectra


def test_what_could_be_a_pattern_counts_less_and_all_else_as_before(trials, group):
    rng = np.random.default_rng(1)
    patterns, _ = planted(rng)
    table = (10 * patterns[:1]).reshape(1, 2, 1, SIZE)
    known = ModelDiscrepancy(group.key, PAYLOADS_KG, ("x",), table)
    hz = np.array([0.0, 1e3])
    floor = NoiseFloor(hz, {"x": np.ones(2)}, {"x": np.zeros(2)}, repeats=0.25)
    problem = Still(read_plant(), trials, [group])
    plain = GaussNewton(problem, floor)
    aware = GaussNewton(problem, replace(floor, patterns=(known,)))
    pattern = 2 * known.rows(group, trials)[0]  # the plant's own error is the root of 1 / repeats
    elsewhere = rng.standard_normal(pattern.shape)
    elsewhere -= pattern * np.sum(pattern * elsewhere) / np.sum(pattern**2)
    size = np.sum(plain.whitened([pattern])[0] ** 2)
    assert size == pytest.approx(800.0, rel=1e-6)  # two repetitions of a pattern of length 20
    assert np.sum(aware.whitened([pattern])[0] ** 2) == pytest.approx(size / (1 + size))
    assert np.allclose(aware.whitened([elsewhere])[0], plain.whitened([elsewhere])[0])


STUDY = "1dof sinusoid 0.5236rad 4.352s 0rad 572x0.017s"


def patterns_named(key, size=1.0):
    return ModelDiscrepancy(key, PAYLOADS_KG, ("x",), np.full((1, 2, 1, SIZE), size))


def test_those_shipped_are_of_the_studys_motion():
    (known,) = patterns_for(read_plant(), [STUDY])
    assert known.key == STUDY
    assert np.isfinite(known.table).all() and known.table.shape[0] == MOST
    assert np.all(np.diff(known.payload_kg) > 0)


def test_ones_own_come_before_those_shipped_and_other_motions_have_none():
    plant, other = read_plant(), "1dof triangle 0.5236rad 4s 0rad 1001x0.017s"
    own = [patterns_named(STUDY.replace("572", "828")), patterns_named(other)]
    assert patterns_for(plant, [STUDY], own) == (own[0],)
    assert patterns_for(plant, [other], own) == (own[1],)
    assert patterns_for(plant, [other]) == ()
    assert patterns_for(replace(plant, load="rigid"), [STUDY, other], own) == ()


def test_patterns_of_several_motions_apply_each_to_its_own(trials, group):
    hz, other = np.array([0.0, 1e3]), patterns_named("another", 5.0)
    known = patterns_named(group.key, 2.0)
    floor = NoiseFloor(hz, {"x": np.ones(2)}, {"x": np.zeros(2)}, patterns=(other, known))
    rows = floor.pattern_rows(group, trials)
    assert len(rows) == 2 and not rows[0].any()
    assert rows[1] == pytest.approx(2.0)
    assert floor.pattern_knowledge(group, trials) == "measured"


def test_patterns_are_read_as_they_were_written(tmp_path):
    known = [patterns_named("one"), patterns_named("two", 3.0)]
    write_patterns(known, tmp_path / "patterns.npz")
    for read, written in zip(read_patterns(tmp_path / "patterns.npz"), known, strict=True):
        assert (read.key, read.signals) == (written.key, written.signals)
        assert np.array_equal(read.payload_kg, written.payload_kg)
        assert np.allclose(read.table, written.table)


def test_a_damaged_file_of_patterns_is_told_with_a_remedy(tmp_path):
    path = tmp_path / "patterns.npz"
    write_patterns([patterns_named("one")], path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="dropstitch calibrate"):
        read_patterns(path)


def test_patterns_grow_with_the_change_of_the_link(trials, group):
    patterns, _ = planted(np.random.default_rng(4))
    known = ModelDiscrepancy(group.key, PAYLOADS_KG, ("x",), patterns[:1].reshape(1, 2, 1, SIZE))
    hz = np.array([0.0, 1e3])
    floor = NoiseFloor(hz, {"x": np.ones(2)}, {"x": np.zeros(2)}, patterns=(known,))
    for change in (0.3, 1.0, 2.0):
        rows = replace(floor, link_change=change).pattern_rows(group, trials)
        assert np.allclose(rows, change * floor.pattern_rows(group, trials))
