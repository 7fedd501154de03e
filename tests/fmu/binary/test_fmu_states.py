"""State machine of an FMU: random sequences of calls, legal ones accepted, others refused."""

import numpy as np
from fmpy.fmi1 import FMICallException
from hypothesis import given, settings
from hypothesis import strategies as st

# The standards' state machines for Co-Simulation without event mode: call -> {state: next state}.
LEGAL = {
    "enter": {"instantiated": "initializing"},
    "exit": {"initializing": "stepping"},
    "step": {"stepping": "stepping"},
    "terminate": {"stepping": "terminated"},
    "set": {s: s for s in ("instantiated", "initializing", "stepping")},
    "get": {s: s for s in ("initializing", "stepping", "terminated")},
    "reset": {
        s: "instantiated" for s in ("instantiated", "initializing", "stepping", "terminated")
    },
}
CALLS = st.lists(st.sampled_from([*LEGAL, "save", "restore"]), min_size=1, max_size=25)


@settings(max_examples=40, deadline=None)
@given(calls=CALLS, torques_nm=st.lists(st.floats(-5, 5), min_size=25, max_size=25))
def test_calls_are_taken_where_they_are_legal_and_only_there(archive, calls, torques_nm):
    with archive.instance() as instance:
        fmu, state, saved = instance.fmu, "instantiated", None
        legal = {call: dict(table) for call, table in LEGAL.items()}
        if archive.fmi == 3:
            legal["get"]["instantiated"] = "instantiated"  # FMI 3.0 shows start values there
        do = {
            "enter": fmu.enterInitializationMode,
            "exit": fmu.exitInitializationMode,
            "step": lambda: instance.step(0.017),
            "terminate": fmu.terminate,
            "get": lambda: instance.get(["tip_x_m", "in_range"]),
            "reset": fmu.reset,
        }
        for call, torque_nm in zip(calls, torques_nm, strict=False):
            if call == "save":
                values = instance.get(["steps", "torque_nm"]) if state == "stepping" else None
                saved = (fmu.getFMUState(), state, instance.time_s, values)
                continue
            if call == "restore":
                if saved:
                    fmu.setFMUState(saved[0])
                    state, instance.time_s = saved[1], saved[2]
                    if saved[3] is not None:
                        np.testing.assert_array_equal(
                            instance.get(["steps", "torque_nm"]), saved[3]
                        )
                continue
            told = len(instance.messages)
            try:
                do.get(call, lambda t=torque_nm: instance.set({"torque_nm": t}))()
                assert state in legal[call]
                state = legal[call][state]
                if call in ("enter", "reset"):
                    instance.time_s = 0.0
            except FMICallException:
                assert state not in legal[call]
                assert len(instance.messages) == told + 1
