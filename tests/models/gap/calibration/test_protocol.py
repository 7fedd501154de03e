"""Protocol of measured trials."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from firmware_py.core.motion import Motion
from models.gap.calibration.trials import MOST_PAYLOADS, protocol_of, repeated
from models.plant.identification.noise_floor import trial_group_key
from models.rig.parameters import read_rig
from models.rig.protocol import TrialCase, run_case


@pytest.fixture(scope="module")
def trials():
    motions = [Motion(amplitude_rad=0.2, period_s=1.0), Motion("multisine", 0.2, 1.0)]
    cases = [TrialCase(m, p, n) for m in motions for p in (0.0, 1.0) for n in (1, 2)]
    return [run_case(read_rig("default"), case) for case in cases]


def with_payload(trial, payload_kg):
    return replace(trial, meta=msgspec.structs.replace(trial.meta, payload_kg=payload_kg))


def test_each_motion_and_payload_is_run_once(trials):
    cases = protocol_of(trials)
    assert [(c.motion.name, c.payload_kg) for c in cases] == [
        ("sinusoid", 0.0), ("sinusoid", 1.0), ("multisine", 0.0), ("multisine", 1.0),
    ]  # fmt: skip
    assert {c.pressure_pa for c in cases} == {t.meta.pressure_pa for t in trials}
    names = {c.name for c in repeated(cases, 2, 5)}
    assert len(names) == 8


def test_of_many_payloads_those_at_even_distances_are_run_with_the_ends(trials):
    many = [with_payload(trials[0], p) for p in np.linspace(0.0, 2.0, 21)]
    payloads = [c.payload_kg for c in protocol_of(many)]
    assert payloads == pytest.approx(np.linspace(0.0, 2.0, MOST_PAYLOADS))


def test_the_conditions_of_a_trial_are_kept(trials):
    tilted = replace(
        trials[0],
        meta=msgspec.structs.replace(
            trials[0].meta, gravity_m_s2=(1.0, 0.0, -9.7), pressure_pa=40e3
        ),
    )
    (case,) = protocol_of([tilted])
    assert case.pressure_pa == 40e3
    again = run_case(read_rig("default"), case)
    size = np.linalg.norm(again.meta.gravity)
    assert again.meta.gravity[0] / size == pytest.approx(1.0 / np.hypot(1.0, 9.7))
    assert trial_group_key(again) == trial_group_key(tilted)
