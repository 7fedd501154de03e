"""Bus plans: transmission times against published ones, and the choice by the servos' answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.bus import codec
from firmware_py.bus.bus_plan import available_s, plain, plans, require_any
from firmware_py.bus.codec import Instruction
from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.loopback import LoopbackTransport
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock

LEGACY, PRO_A, XM = 54024, 54025, 1020
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


def test_too_slow_a_bus_is_refused_with_the_numbers_and_the_rate_that_will_do():
    with pytest.raises(InputError, match=r"robot\.toml: .* need 25\.6 ms .*use ≥ 1 Mbaud"):
        require_any(plans(PRO_P, 4, 57_600), available_s(0.017, 0.008), "robot.toml")


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


class PickyTransport(LoopbackTransport):
    """Servos that do not know one instruction, or refuse to be written in one place."""

    def __init__(self, models, clock, deaf_to=None, locked=None):
        super().__init__(models)
        self.clock, self.deaf_to, self.locked, self.written = clock, deaf_to, locked, []

    def _execute(self, packet):
        written = packet.instruction == Instruction.WRITE and codec.word(packet.parameters, 0)
        self.written.append(written)
        if packet.instruction != self.deaf_to and written != self.locked:
            super()._execute(packet)

    def read(self, size, deadline_ns):
        data = super().read(size, deadline_ns)
        if size and not data:
            self.clock.sleep_until(deadline_ns)
        return data


def connect(number, servos, **traits):
    clock, models = SimClock(), {k: MODELS[number] for k in range(1, servos + 1)}
    transport = PickyTransport(models, clock, **traits)
    setups = [ServoSetup(k, model, -0.6, 0.6) for k, model in models.items()]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
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
    bus, transport, clock = connect(number, servos, **traits)
    assert bus.plan.name == name
    for servo in range(1, servos + 1):
        transport.put(servo, Register.PRESENT_POSITION, 1000 * servo)
        transport.put(servo, Register.PRESENT_CURRENT, -7 * servo)
    assert bus.read(clock.now_ns() + 8_000_000) is BusStatus.OK
    model = MODELS[number]
    joints = np.arange(1, servos + 1)
    assert bus.angle_rad == pytest.approx([model.angle_rad(1000 * j) for j in joints])
    assert bus.current_a == pytest.approx([model.current_a(-7 * j) for j in joints])


def test_indirect_addresses_that_are_right_are_not_written_again():
    _, transport, clock = connect(PRO_A, 2)
    transport.written.clear()
    setups = [ServoSetup(k, MODELS[PRO_A], -0.6, 0.6) for k in (1, 2)]
    DynamixelBus(transport, setups, clock, period_s=0.017).connect()
    assert 168 not in transport.written


@pytest.mark.parametrize("block", [0, 1])
def test_a_refusal_or_alert_inside_the_common_packet_is_seen(block):
    bus, transport, clock = connect(PRO_A, 2)

    def tampered(error):
        def read(size, deadline_ns):
            data = bytearray(LoopbackTransport.read(transport, size, deadline_ns))
            if data and data[4] == codec.BROADCAST:
                data[8 + block * (len(data) - 8) // 2] = error
                data[-2:] = codec.crc16(data[:-2]).to_bytes(2, "little")
            return bytes(data)

        return read

    transport.read = tampered(7)
    assert bus.read(clock.now_ns() + 8_000_000) is BusStatus.REFUSED
    transport.read = tampered(0x80)
    assert bus.read(clock.now_ns() + 8_000_000) is BusStatus.ALERT
