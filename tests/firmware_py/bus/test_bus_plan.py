"""Bus plans: transmission times against published ones, and the choice by the servos' answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus import codec
from firmware_py.bus.bus_plan import available_s, plain, plans
from firmware_py.bus.codec import Instruction
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from tests.firmware_py.bus.tampered import (
    LEGACY,
    PRO_A,
    XM,
    TamperedTransport,
    make,
    read,
    with_error,
)

PRO_P = MODELS[PRO_A].table


@pytest.mark.parametrize(
    # docs/sources.md, "Control tables": sync read and sync write, A/P block,
    # default return delay of 500 µs.
    ("baud", "published_ms"),
    [
        (57_600, (10.05, 15.24, 25.6)),
        (4_000_000, (0.64, 1.21, 2.34)),
    ],
)
def test_the_plain_plan_takes_the_published_time(baud, published_ms):
    calculated_ms = [plain(plans(PRO_P, n, baud)).total_s * 1e3 for n in (1, 2, 4)]
    assert calculated_ms == pytest.approx(published_ms, rel=5e-3)


def test_transmission_gets_the_period_less_a_reserve_or_the_timeout_if_that_is_shorter():
    assert available_s(0.005, 0.008) == pytest.approx(0.003)
    assert available_s(0.017, 0.008) == 0.008


@given(
    table=st.sampled_from([model.table for model in MODELS.values()]),
    servos=st.integers(1, 20),
    baud=st.sampled_from([57_600, 1_000_000, 4_000_000]),
    delay_s=st.floats(0.0, 508e-6),
)
def test_the_first_plan_is_the_fastest_and_the_plain_one_is_always_there(
    table, servos, baud, delay_s
):
    possible = plans(table, servos, baud, delay_s)
    assert possible[0].total_s == min(plan.total_s for plan in possible)
    assert plain(possible).block == table.feedback
    if servos == 1 or not table.fast_sync_read:  # a common packet saves nothing for one
        assert not possible[0].fast
    elif delay_s > 100e-6:
        assert possible[0].fast
    for plan in possible:  # indirect addresses in RAM would show zeros after a reboot
        assert not plan.indirect or table.indirect.address < table.ram_start


class PickyTransport(TamperedTransport):
    """Servos that do not know one instruction, or refuse to be written at one address."""

    deaf_to = locked = None

    def _execute(self, packet):
        written = packet.instruction == Instruction.WRITE and codec.word(packet.parameters, 0)
        if packet.instruction != self.deaf_to and written != self.locked:
            super()._execute(packet)


def connected(number, servos, **traits):
    bus, transport, clock = make(*[number] * servos, transport_type=PickyTransport)
    vars(transport).update(traits)
    bus.connect()
    return bus, transport, clock


@pytest.mark.parametrize(
    ("number", "servos", "traits", "name"),
    [
        (LEGACY, 1, {}, "sync read, indirect"),
        (LEGACY, 2, {"locked": 49}, "sync read"),
        (PRO_A, 1, {}, "sync read, indirect"),
        (PRO_A, 2, {}, "fast sync read, indirect"),
        (PRO_A, 2, {"deaf_to": 0x8A}, "sync read, indirect"),
        (PRO_A, 2, {"locked": 168, "deaf_to": 0x8A}, "sync read"),
        (XM, 2, {}, "fast sync read"),
    ],
)
def test_the_fastest_plan_that_the_servos_answer_is_used(number, servos, traits, name):
    bus, transport, clock = connected(number, servos, **traits)
    assert bus.plan.name == name
    for servo in range(1, servos + 1):
        transport.put(servo, Register.PRESENT_POSITION, 1000 * servo)
        transport.put(servo, Register.PRESENT_CURRENT, -7 * servo)
    assert read(bus, clock) is BusStatus.OK
    model = MODELS[number]
    joints = np.arange(1, servos + 1)
    assert bus.angle_rad == pytest.approx([model.angle_rad(1000 * j) for j in joints])
    assert bus.current_a == pytest.approx([model.current_a(-7 * j) for j in joints])


def test_indirect_addresses_that_are_right_are_not_written_again():
    bus, transport, _ = connected(PRO_A, 2)
    transport.written.clear()
    bus.connect()
    addresses = [codec.word(w, 8) for w in transport.written if w[7] == Instruction.WRITE]
    assert addresses and PRO_P.indirect.address not in addresses


@pytest.mark.parametrize("block", [0, 1])
@pytest.mark.parametrize(("error", "status"), [(7, BusStatus.REFUSED), (0x80, BusStatus.ALERT)])
def test_a_refusal_or_alert_inside_the_common_packet_is_seen(block, error, status):
    bus, transport, clock = connected(PRO_A, 2)

    def tamper(data):
        at = 8 + block * (len(data) - 8) // 2
        return with_error(data, error, at) if data[4] == codec.BROADCAST else data

    transport.tamper = tamper
    assert read(bus, clock) is status
