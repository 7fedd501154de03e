"""Serialised states of an FMU: what is damaged or forged is refused and changes nothing."""

import math
import struct

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from firmware_py.core.signals import PERIOD_S

OUTPUTS = ["time", "tip_x_m", "tip_z_m", "torque_filtered_nm", "steps"]


def _serialized(instance):
    instance.get(OUTPUTS)  # calculated, they are part of the state
    state = instance.fmu.getFMUState()
    data = instance.fmu.serializeFMUState(state)
    instance.fmu.freeFMUState(state)
    return data


def _refused(instance, data):
    """The sentence with which the FMU refuses bytes."""
    logged = len(instance.messages)
    with pytest.raises(FMICallException, match="status 3"):
        instance.fmu.deserializeFMUState(data)
    assert len(instance.messages) == logged + 1
    return instance.messages[-1]


def _go_on(instance):
    rows = []
    for _ in range(5):
        instance.step(PERIOD_S)
        rows.append(instance.get(OUTPUTS))
    return np.array(rows)


def test_every_flipped_bit_is_noticed(moving, archive):
    data, time_s = _serialized(moving), moving.time_s
    for bit in range(8 * len(data)):
        wrong = bytearray(data)
        wrong[bit // 8] ^= 1 << bit % 8
        assert "saved state" in _refused(moving, bytes(wrong))
    expected = _go_on(moving)
    with archive.instance() as other:
        other.fmu.setFMUState(other.fmu.deserializeFMUState(data))
        other.time_s = time_s
        np.testing.assert_array_equal(_go_on(other), expected)


def _hash(data):
    """FNV-1a in 64 bits (Fowler, Noll and Vo), the hash in the first eight bytes of a state."""
    value = 0xCBF29CE484222325
    for byte in data:
        value = (value ^ byte) * 0x100000001B3 % 2**64
    return value


def _forged(data, old, new):
    """Bytes with one number replaced where it first stands, and the hash that fits."""
    where = data.index(struct.pack("<d", old))
    content = data[8:where] + struct.pack("<d", new) + data[where + 8 :]
    return struct.pack("<Q", _hash(content)) + content


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("tip_x_m", math.nan, "finite"), ("time", math.inf, "finite"),
        ("torque_nm", 1e3, "torque_nm = 1000 lies outside"),
        ("parameters.length_m", -5.0, "parameters.length_m = -5 lies outside"),
    ],
)  # fmt: skip
def test_a_state_with_a_fitting_hash_needs_finite_values_within_bounds(moving, name, value, words):
    data = _serialized(moving)
    old = float(moving.get([name])[0])
    moving.fmu.deserializeFMUState(_forged(data, old, old))
    assert words in _refused(moving, _forged(data, old, value))
    _go_on(moving)


def test_a_state_without_a_mode_is_refused(moving):
    data = _serialized(moving)
    content = data[8:-16] + struct.pack("<iiii", 3, 0, 1, 0)
    assert "saved state" in _refused(moving, struct.pack("<Q", _hash(content)) + content)
