"""Kinds of faults: each acts where and when it says, and what cannot act is refused."""

import shutil

import pytest

from firmware_py.bus import codec
from firmware_py.bus.codec import BROADCAST, Instruction, Packet
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_models import MODELS
from firmware_py.core.errors import InputError
from firmware_py.inference.bundle import ModelBundle
from hil.faults.fault_kinds import FAULT_KINDS
from hil.faults.fault_row import Expectation, FaultRow, Injection
from hil.faults.fault_table import ROWS
from hil.faults.faulty_parts import FaultSchedule
from hil.faults.servo_log import LATE_NS, LoggedBus, LoggedServo
from tests.hil.conftest import LagPlant

LEGACY, PRO_A = 54024, 54025
FRAME = codec.build_status(1, 0, bytes(range(10)))
OF_REPLIES = [name for name, kind in FAULT_KINDS.items() if kind.where == "reply"]


def test_an_unknown_kind_of_fault_is_refused():
    with pytest.raises(ValueError, match="no fault 'noyse': choose from lost, late"):
        Injection("noyse")


@pytest.mark.parametrize(("kind", "line"), [("signal", "virtual"), ("lost", "process")])
def test_a_fault_on_a_line_where_it_cannot_act_is_refused(kind, line):
    with pytest.raises(ValueError, match=f"a fault '{kind}' needs"):
        FaultRow("x", "y", Expectation("finished"), (Injection(kind),), (line,))


@pytest.mark.parametrize(
    ("changes", "injection"),
    [({"lines": ("virtul",)}, {}), ({}, {"joint": 1}), ({"joints": 2}, {"joint": 2})],
    ids=["no line", "a second joint of one", "a third joint of two"],
)
def test_a_row_of_a_line_or_joint_that_does_not_exist_is_refused(changes, injection):
    with pytest.raises(ValueError, match="x: "):
        FaultRow("x", "y", Expectation("finished"), (Injection("lost", **injection),), **changes)


@pytest.mark.parametrize("kind", OF_REPLIES)
def test_a_fault_of_the_line_acts_in_its_exchanges_and_no_other(kind):
    script = FaultSchedule((Injection(kind, 2, 5e-3),), seed=3)
    arrivals = {}
    for exchange in range(script.start + 4):
        script.begin_exchange((), exchange)
        arrivals[script.exchange] = script.apply(FRAME)
    hit = [exchange for exchange, what in arrivals.items() if what != [(0, FRAME)]]
    assert hit == [script.start, script.start + 1]
    assert script.began_ns == script.start - 1


@pytest.mark.parametrize("kind", [k for k in OF_REPLIES if k.startswith("flip") or k == "other id"])
def test_a_flipped_bit_leaves_no_intact_answer_of_that_servo(kind):
    for seed in range(20):
        script = FaultSchedule((Injection(kind, 1000),), seed)
        for _ in range(script.start):
            script.begin_exchange((), 0)
        ((_, damaged),) = script.apply(FRAME)
        assert len(damaged) == len(FRAME)
        assert not any(p.intact and p.id == 1 for p in codec.PacketSearch(host=False).feed(damaged))
        if kind != "other id":
            flipped = int.from_bytes(damaged, "big") ^ int.from_bytes(FRAME, "big")
            assert flipped.bit_count() == 1


@pytest.mark.parametrize(
    "row", [row for row in ROWS if row.injects("bundle")], ids=lambda row: row.how
)
def test_a_damaged_bundle_is_refused_for_its_damage(toy_bundle, tmp_path, row):
    bundle = shutil.copytree(toy_bundle, tmp_path / "bundle")
    ModelBundle.load(bundle)
    keys = row.injections[0].does.act(bundle)
    with pytest.raises(InputError) as refused:
        ModelBundle.load(bundle, keys)
    assert row.must.reason in str(refused.value)


# --- the servos' log


def logged_bus(number, kind=LoggedBus):
    servo = LoggedServo(MODELS[number])
    return kind([servo], LagPlant(), FaultSchedule((), 0)), servo


def test_replies_that_leave_late_and_replies_after_a_preemption_are_counted():
    """A preemption counts while a servo is driven; the reply itself may then leave on time."""
    bus, _ = logged_bus(PRO_A)
    for late_ns in (0, LATE_NS, LATE_NS + 1):
        bus.note_release(5, 5 + late_ns)
    bus.note_release(5, 5, 2 * LATE_NS + 1)
    log = bus.log(10)
    assert (log.late_replies, log.held_up_replies) == (1, 0)
    driven, _ = logged_bus(PRO_A, type("DrivenBus", (LoggedBus,), {"driven": True}))
    for delay_ns in (0, LATE_NS, 2 * LATE_NS + 1, 2 * LATE_NS + 1):
        driven.note_release(5, 5, delay_ns)
    log = driven.log(10)
    assert (log.late_replies, log.held_up_replies) == (0, 1)


@pytest.mark.parametrize(
    ("number", "watchdog", "unheard_ms", "live"),
    [(PRO_A, 3, 60, False), (PRO_A, 0, 500, True), (LEGACY, 3, 500, True)],
)
def test_a_loop_that_dies_leaves_a_servo_driven_until_its_watchdog_trips(
    number, watchdog, unheard_ms, live
):
    bus, servo = logged_bus(number)
    servo.put(Register.TORQUE_ENABLE, 1)
    servo.put(Register.BUS_WATCHDOG, watchdog)
    bus.execute(Packet(BROADCAST, Instruction.PING, b""), 0)
    log = bus.log(500_000_000)
    assert log.unheard_ns == unheard_ms * 1_000_000
    assert (log.live, log.watched) == (live, number == PRO_A)


def test_a_servo_off_the_bus_neither_answers_nor_receives():
    bus, servo = logged_bus(PRO_A)
    servo.put(Register.TORQUE_ENABLE, 1)
    servo.put(Register.BUS_WATCHDOG, 3)
    servo.hush(True)
    assert bus.execute(Packet(1, Instruction.PING, b""), 10_000_000) == []
    bus.execute(Packet(BROADCAST, Instruction.PING, b""), 70_000_000)
    assert servo.watchdog_tripped
