"""Settings of a servo that the plant assumes: others are refused, a profile is removed."""

import math

import pytest

from firmware_py.bus.dynamixel import DynamixelBus
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS, ServoGains
from firmware_py.bus.servo_setup import AssumedSettings, ServoSetup
from firmware_py.config import BusConfig, RobotConfig, ServoConfig, check_config
from firmware_py.core.errors import InputError
from firmware_py.system.clock import SimClock
from tests.firmware_py.bus.tampered import LEGACY, PRO_A, XM, TamperedTransport

ALL = pytest.mark.parametrize("number", [LEGACY, PRO_A, XM])
NEW = pytest.mark.parametrize("number", [PRO_A, XM])


def servo(number, *, settings=None, rate=math.inf, **changed):
    """A bus with one servo whose registers are changed."""
    clock, models = SimClock(), {1: MODELS[number]}
    transport = TamperedTransport(models, clock)
    for name, raw in changed.items():
        transport.put(1, Register[name], raw)
    setup = ServoSetup(1, models[1], -0.6, 0.6, rate, settings or AssumedSettings())
    return DynamixelBus(transport, [setup], clock, period_s=0.017), transport


def refusal(number, settings=None, **changed):
    bus, _ = servo(number, settings=settings, **changed)
    with pytest.raises(InputError) as raised:
        bus.connect()
    return str(raised.value)


@NEW
@pytest.mark.parametrize("mode", [1, 8])
def test_a_drive_mode_that_is_not_declared_is_refused(number, mode):
    assert f"Drive Mode {mode}" in refusal(number, DRIVE_MODE=mode)


@NEW
def test_a_reverse_servo_is_accepted_where_it_is_declared_and_only_there(number):
    reverse = AssumedSettings(reverse=True)
    servo(number, settings=reverse, DRIVE_MODE=1)[0].connect()
    assert "Drive Mode 0" in refusal(number, reverse)


@ALL
@pytest.mark.parametrize("raw", [-2, 1000])
def test_a_homing_offset_that_is_not_declared_is_refused(number, raw):
    assert "Homing Offset" in refusal(number, HOMING_OFFSET=raw)


@ALL
def test_a_declared_homing_offset_is_accepted_to_the_pulse(number):
    offset_rad = 1000.4 * MODELS[number].rad_per_pulse
    settings = AssumedSettings(homing_offset_rad=offset_rad)
    servo(number, settings=settings, HOMING_OFFSET=1000)[0].connect()
    assert "Homing Offset" in refusal(number, settings, HOMING_OFFSET=998)
    assert "Homing Offset" in refusal(number, settings)


@ALL
@pytest.mark.parametrize("gain", ["POSITION_P_GAIN", "VELOCITY_P_GAIN", "VELOCITY_I_GAIN"])
def test_gains_other_than_those_of_the_plant_are_refused(number, gain):
    settings = AssumedSettings(gains={Register[gain]: 640})
    servo(number, settings=settings, **{gain: 640})[0].connect()
    words = refusal(number, settings, **{gain: 641})
    assert all(word in words for word in (Register[gain].value, "641", "640"))


@ALL
def test_a_profile_that_is_left_behind_is_removed(number):
    bus, transport = servo(number, rate=1.0, PROFILE_ACCELERATION=5, PROFILE_VELOCITY=7)
    bus.connect()
    assert transport.get(1, Register.PROFILE_ACCELERATION) == 0
    lsb = MODELS[number].velocity_rad_s_per_lsb
    limit = math.ceil(1.0 / lsb) if number == LEGACY else 0
    assert transport.get(1, Register.PROFILE_VELOCITY) == limit


@ALL
@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_confirms_nothing_is_told_by_its_status_return_level(number, level):
    assert f"Status Return Level {level}" in refusal(number, STATUS_RETURN_LEVEL=level)


@ALL
def test_a_servo_that_answers_only_a_ping_is_told_from_one_without_power(number):
    bus, transport = servo(number)
    ping = 14  # bytes of its answer
    transport.tamper = lambda data: data if len(data) == ping else b""
    with pytest.raises(InputError, match=r"answers a ping but no read.*Status Return Level is 0"):
        bus.connect()
    transport.tamper = lambda data: b""
    with pytest.raises(InputError, match="check its power"):
        bus.connect()


@ALL
def test_the_settings_found_are_read_without_a_change(number):
    bus, transport = servo(number, POSITION_P_GAIN=32, HOMING_OFFSET=3)
    before = bytes(transport.memory[1])
    (found,) = bus.found_settings()
    assert (found["Position P Gain"], found["Homing Offset"]) == (32, 3)
    assert ("Position D Gain" in found) is (number != LEGACY)
    assert bytes(transport.memory[1]) == before


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"reverse": True}, "has no Drive Mode"),
        ({"gains": ServoGains(position_d=1)}, "has no Position D Gain"),
        ({"homing_offset_rad": 4.0}, "homing_offset_rad is 4.0"),
        ({"homing_offset_rad": math.nan}, "homing_offset_rad is nan"),
    ],
)
def test_a_setting_that_the_model_has_not_is_refused(changed, words):
    servos = (ServoConfig(id=1, model="H54-200-S500-R", **changed),)
    config = RobotConfig(bundle="b", bus=BusConfig(port="p"), servos=servos)
    with pytest.raises(InputError, match=words):
        check_config(config, "robot.toml")
