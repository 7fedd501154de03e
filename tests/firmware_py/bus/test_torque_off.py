"""Torque off: a servo counts as released only where it has heard of it and says so."""

import pytest

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import MODELS
from firmware_py.bus.servo_setup import ServoSetup
from firmware_py.system.clock import SimClock
from tests.firmware_py.bus.tampered import LEGACY, PRO_A, XM, TamperedTransport

WRITE = 3


class LossyTransport(TamperedTransport):
    """The first torque-off to each servo is lost; answers to an earlier read come instead."""

    unheard, late = True, b""

    def __init__(self, models, clock):
        super().__init__(models, clock)
        self.sent = dict.fromkeys(models, 0)
        self._torque = next(iter(models.values())).table[Register.TORQUE_ENABLE].address

    def is_torque_off(self, data):
        address = int.from_bytes(data[8:10], "little")
        return data[7] == WRITE and address == self._torque and data[10:-2] == b"\0"

    def write(self, data):
        if self.unheard and self.is_torque_off(data):
            self.sent[data[4]] += 1
            if self.sent[data[4]] == 1:
                self._answers += self.late
                return len(data)
        return super().write(data)


class BrokenTransport(LossyTransport):
    """A servo confirms torque off, but stays on."""

    broken = True

    def _store(self, id_, address, data):
        if self.broken and address == self._torque and data == b"\0":
            return
        super()._store(id_, address, data)


def driven(number, transport_type):
    clock, models = SimClock(), {1: MODELS[number], 2: MODELS[number]}
    transport = transport_type(models, clock)
    transport.unheard = transport.broken = False
    setups = [ServoSetup(id_, model, -0.6, 0.6) for id_, model in models.items()]
    bus = DynamixelBus(transport, setups, clock, period_s=0.017)
    bus.connect()
    assert bus.torque(True) is BusStatus.OK
    return bus, transport, clock


def torques(transport):
    return [transport.get(id_, Register.TORQUE_ENABLE) for id_ in (1, 2)]


@pytest.mark.parametrize("number", [LEGACY, PRO_A, XM])
def test_a_late_answer_to_a_read_confirms_no_torque_off(number):
    bus, transport, clock = driven(number, LossyTransport)
    kept = []
    transport.tamper = lambda data: kept.append(data) or b""
    assert not bus.read(clock.now_ns() + 8_000_000).fresh
    transport.tamper, transport.late, transport.unheard = lambda data: data, kept[0], True
    assert len(kept[0]) > 22
    assert bus.torque(False) is BusStatus.OK
    assert torques(transport) == [0, 0]
    assert transport.sent == {1: 2, 2: 2}


@pytest.mark.parametrize("number", [LEGACY, PRO_A])
def test_a_servo_that_confirms_but_stays_on_is_not_released(number):
    bus, transport, _ = driven(number, BrokenTransport)
    transport.broken = True
    assert bus.torque(False) is BusStatus.TIMEOUT
    assert torques(transport) == [1, 1]
    transport.broken = False
    bus.close()
    assert torques(transport) == [0, 0], "it is tried again at the end"


def test_a_servo_that_answers_no_read_is_not_released():
    bus, transport, _ = driven(LEGACY, LossyTransport)
    transport.tamper = lambda data: data if len(data) == 11 else b""
    assert bus.torque(False) is BusStatus.TIMEOUT
