"""Safety requirements of docs/safety.md, each with its tests and faults.

`python -m hil.faults.fault_docs` writes them into the page as a table. A test checks that the named
tests and faults exist.
"""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from typing import Final, NamedTuple

from hil.faults.fault_table import ROWS


class SafetyRequirement(NamedTuple):
    """Safety requirement and its verification."""

    identifier: str  # "SR-" and a number, as in the page
    sentence: str
    tests: tuple[str, ...] = ()  # File under `tests/`, `::` and the name of the test
    faults: tuple[str, ...] = ()  # Faults in the fault table; `*` matches any text
    no_fault: str = ""  # Why no fault of the table can verify it; empty if one does


_T: Final = "firmware_py"

REQUIREMENTS: Final = (
    SafetyRequirement(
        "SR-01", "The supervisor makes no transition that is not drawn.",
        (f"{_T}/safety/test_supervisor.py::test_the_machine_makes_no_step_that_is_not_drawn",),
        no_fault="a fault shows a path that is taken; the test tries every path that must not be",
    ),
    SafetyRequirement(
        "SR-02", "A servo that is unfit is refused in one sentence before the torque is on.",
        (
            f"{_T}/bus/test_dynamixel.py::test_a_servo_that_is_unfit_is_named_with_what_is_wrong",
            f"{_T}/test_robot_commands.py::test_a_set_up_that_cannot_run_gets_one_sentence",
        ),
        (
            "wrong model number", "legacy and new PRO on one bus", "latency timer 16",
            "wrong baud", "shutdown, then started again",
        ),
    ),
    SafetyRequirement(
        "SR-03", "A servo whose settings are not those that the plant assumes is refused.",
        (
            f"{_T}/bus/test_servo_settings.py::test_gains_other_than_those_of_the_plant_are_refused",
            f"{_T}/bus/test_servo_settings.py::test_a_homing_offset_that_is_not_declared_is_refused",
        ),
        ("changed servo setting",),
    ),
    SafetyRequirement(
        "SR-04", "Goals never jump: not at the start, after missed slots or after a replug.",
        (
            f"{_T}/safety/test_blend.py::test_goals_start_where_the_arm_stands_and_end_in_the_motion",
            f"{_T}/safety/test_blend.py::test_skipped_slots_make_no_jump_in_goal_or_speed",
            "hil/faults/test_campaign.py::test_goals_that_jump_after_a_replug_are_found_out",
        ),
        ("host stall of 20 ms", "unplug and replug", "clock stepped by +1 h"),
    ),
    SafetyRequirement(
        "SR-05", "An arm that leans goes to its motion slowly; beyond its limits it stays there.",
        (
            f"{_T}/test_loop.py::test_an_arm_that_leans_goes_to_the_motion_before_it_begins",
            f"{_T}/safety/test_blend.py::test_an_approach_takes_a_quarter_of_what_is_allowed",
        ),
        ("arm leans at the start",),
    ),
    SafetyRequirement(
        "SR-06", "Every end that the program can handle switches the torque off.",
        (f"{_T}/test_loop_ends.py::test_whatever_is_raised_leaves_no_servo_driven",),
        ("lost reply", "together: 5 % each of six faults of the line"),
    ),
    SafetyRequirement(
        "SR-07", "Every signal that can be handled stops the robot like SIGTERM.",
        (
            f"{_T}/system/test_stop_signals.py::test_a_signal_brings_a_controlled_stop",
            f"{_T}/system/test_stop_signals.py::"
            "test_every_signal_that_ends_or_halts_a_process_is_handled_but_kill_stop_and_crashes",
        ),
        ("SIGTERM in motion", "SIGHUP in motion", "SIGQUIT in motion", "SIGUSR1 in motion",
         "SIGUSR2 in motion", "SIGPIPE in motion", "SIGTSTP in motion"),
    ),
    SafetyRequirement(
        "SR-08",
        "A run is a success only where no fault stopped it or was seen while it stopped, every "
        "torque confirmed off and the log holds every tick.",
        (
            f"{_T}/test_loop_ends.py::test_a_servo_that_does_not_confirm_torque_off_is_no_success",
            f"{_T}/bus/test_torque_off.py::test_a_late_answer_to_a_read_confirms_no_torque_off",
            f"{_T}/test_robot_commands.py::test_a_trip_is_reported_and_is_a_negative_verdict",
            f"{_T}/commands/test_run_verdict.py::test_a_log_that_lacks_ticks_is_no_success",
        ),
        ("* while stopping", "torque off unheard, late replies", "unplug and replug"),
    ),
    SafetyRequirement(
        "SR-09", "An alert, a measurement beyond a limit or a lost port ends the hold of a stop.",
        (
            f"{_T}/safety/test_supervisor.py::"
            "test_a_fault_while_the_robot_stops_is_said_and_ends_the_hold_where_holding_is_worse",
        ),
        ("overload while stopping", "torque lost while stopping", "current of 12 A while stopping",
         "unplug while stopping"),
    ),
    SafetyRequirement(
        "SR-10", "The robot starts again by itself only where a lost port alone has stopped it.",
        (
            f"{_T}/test_loop_ends.py::"
            "test_a_robot_that_an_alert_stopped_does_not_start_again_when_its_port_is_back",
            f"{_T}/test_loop_ends.py::"
            "test_a_port_that_goes_while_the_robot_stops_does_not_start_it_again",
        ),
        ("unplug and replug",),
    ),
    SafetyRequirement(
        "SR-11", "The watchdog of a servo is armed with three periods where the model has one.",
        (
            f"{_T}/bus/test_dynamixel.py::test_torque_arms_a_watchdog_of_at_least_three_periods",
            "hil/faults/test_campaign.py::"
            "test_a_loop_that_dies_leaves_a_servo_driven_until_its_watchdog_trips",
        ),
        ("SIGKILL in motion",),
    ),
    SafetyRequirement(
        "SR-12", "What SIGKILL and a power loss leave behind is said, and `release` removes it.",
        (
            f"{_T}/bus/test_watchdog_claims.py::"
            "test_the_help_of_run_says_what_sigkill_leaves_behind",
            f"{_T}/test_robot_commands.py::test_a_servo_that_somebody_left_driven_is_released",
        ),
        ("SIGKILL in motion",),
    ),
    SafetyRequirement(
        "SR-13", "A servo without a watchdog is limited to 1 rad/s, by its own register as well.",
        (
            f"{_T}/bus/test_dynamixel.py::"
            "test_a_servo_without_a_watchdog_keeps_the_speed_limit_itself",
            f"{_T}/test_config.py::test_servos_without_a_watchdog_are_driven_more_slowly",
        ),
        ("SIGKILL in motion", "SIGHUP in motion"),
    ),
    SafetyRequirement(
        "SR-14", "An unplugged port stops the robot; when it is back, every check is repeated.",
        (
            f"{_T}/test_loop_ends.py::"
            "test_a_port_that_comes_back_lets_the_robot_go_on_from_where_it_stands",
            f"{_T}/bus/test_dynamixel.py::test_a_port_that_is_back_is_opened_anew",
        ),
        ("unplug", "unplug and replug", "together: unplugged during a bad stretch"),
    ),
    SafetyRequirement(
        "SR-15", "A read that fails is repeated once in the same tick.",
        (
            f"{_T}/bus/test_feedback.py::"
            "test_a_lost_answer_is_asked_for_again_where_both_reads_fit",
            "hil/faults/test_campaign.py::test_a_bus_that_does_not_read_again_is_found_out",
        ),
        ("lost reply", "reply late by 1 ms", "reply late by 5 ms", "one servo silent"),
    ),
    SafetyRequirement(
        "SR-16", "`limits.stale_ticks` ticks in a row without fresh data stop the robot.",
        (
            f"{_T}/safety/test_supervisor.py::test_stale_data_degrades_and_then_stops",
            f"{_T}/test_loop.py::test_stale_data_degrades_and_three_in_a_row_stop_the_robot",
        ),
        ("lost reply", "one servo silent", "both servos silent", "lost replies while stopping",
         "together: *"),
    ),
    SafetyRequirement(
        "SR-17", "The deadline of a tick holds whatever the line sends.",
        (
            f"{_T}/bus/test_floods.py::"
            "test_a_flood_ends_a_read_at_its_deadline_with_a_bounded_number_of_bytes",
            f"{_T}/bus/test_floods.py::test_a_discard_ends_while_bytes_keep_coming",
        ),
        ("babbling line", "flood of bytes", "return delay at its default"),
    ),
    SafetyRequirement(
        "SR-18", "No old data passes for fresh.",
        (
            f"{_T}/bus/test_feedback.py::"
            "test_the_answer_to_an_earlier_read_is_never_taken_for_this_one",
            "hil/faults/test_campaign.py::"
            "test_a_bus_that_takes_late_answers_for_fresh_is_found_out",
        ),
        ("reply late by a period", "reply late by 20 ms", "duplicated reply"),
    ),
    SafetyRequirement(
        "SR-19", "A servo that does not drive although it should stops the robot.",
        (f"{_T}/bus/test_feedback.py::test_a_servo_that_does_not_drive_says_so_in_the_next_read",),
        ("reboot in motion", "torque lost", "watchdog trip"),
    ),
    SafetyRequirement(
        "SR-20", "Damaged, foreign or stuffed bytes never become data or goals.",
        (
            f"{_T}/bus/test_codec.py::test_no_packet_with_a_flipped_bit_is_taken_for_intact",
            f"{_T}/bus/test_codec.py::test_whatever_is_sent_arrives_and_holds_no_false_header",
        ),
        ("bit flip in *", "truncation", "noise before a packet", "reply from another id",
         "goal whose bytes need stuffing"),
    ),
    SafetyRequirement(
        "SR-21", "A measurement, a tip or a DI beyond its limit for three samples stops the robot.",
        (
            f"{_T}/safety/test_limits.py::test_current_at_its_limit",
            f"{_T}/safety/test_limits.py::test_a_value_that_is_no_number_stops_the_robot",
        ),
        ("encoder jump of 0.3 rad", "current spike of 12 A", "NaN out of *", "infinity out of *"),
    ),
    SafetyRequirement(
        "SR-22", "No goal leaves the limits of angle, rate and acceleration.",
        (
            f"{_T}/safety/test_limits.py::test_goal_rate_at_its_limit",
            f"{_T}/safety/test_limits.py::test_a_goal_that_is_no_number_is_never_admitted",
        ),
        ("goal whose bytes need stuffing",),
    ),
    SafetyRequirement(
        "SR-23", "A hardware error stops the robot in its tick and is named.",
        (
            f"{_T}/safety/test_supervisor.py::test_a_hardware_error_stops_at_once_and_is_named",
            f"{_T}/bus/test_servo_models.py::test_hardware_errors_are_named_by_bit",
        ),
        ("hardware error",),
    ),
    SafetyRequirement(
        "SR-24", "A loop that is late, or whose clock is set, stops the robot.",
        (
            f"{_T}/test_loop_ends.py::test_a_loop_that_is_always_too_slow_stops",
            f"{_T}/test_loop_ends.py::test_a_clock_that_leaps_stops_the_robot_in_its_own_time",
        ),
        ("predictor taking 30 ms", "host stall of *", "garbage-collector pressure", "clock *"),
    ),
    SafetyRequirement(
        "SR-25", "Recorder, disk, viewers and files on disk do not touch the loop.",
        (
            f"{_T}/log/test_recorder.py::"
            "test_a_recorder_that_stands_still_or_dies_costs_drops_and_nothing_else",
            f"{_T}/log/test_live_view.py::"
            "test_a_viewer_that_dies_or_stands_still_costs_the_log_nothing",
        ),
        ("recorder dead", "recorder blocked", "full disk", "bundle swapped on disk"),
    ),
    SafetyRequirement(
        "SR-26", "A bundle runs only where its files, its golden ticks and its signature agree.",
        (
            f"{_T}/inference/test_bundle_trust.py::test_an_older_bundle_of_the_same_key_is_refused",
            f"{_T}/inference/test_bundle_trust.py::test_a_manifest_that_names_another_file_is_refused",
            f"{_T}/inference/test_bundle_trust.py::test_a_signed_bundle_is_trusted_by_its_key_alone",
            f"{_T}/inference/test_bundle.py::test_golden_ticks_that_prove_nothing_are_refused",
            f"{_T}/inference/test_bundle.py::test_a_changed_value_in_the_manifest_is_refused",
        ),
        ("unfit bundle",),
    ),
    SafetyRequirement(
        "SR-27", "The same recorded run gives the same goals, states and end, or it is declared.",
        ("hil/faults/test_recorded_runs.py::test_a_recorded_run_is_answered_as_it_was",),
        no_fault="what it guards against is a change of the code, which no case of a campaign is; "
        "the test replays the runs of all faults of the virtual line",
    ),
    SafetyRequirement(
        "SR-28", "Corrections by a tip that is not trusted are gone within 0.2 s.",
        (
            f"{_T}/goals/test_tip_feedback.py::"
            "test_corrections_fade_within_200_ms_and_come_back",
            f"{_T}/goals/test_tip_feedback.py::test_the_robot_stops_where_it_is_told_to",
        ),
        (
            "innovation of the current too large", "estimated tip *", "stale data under feedback",
            "host stall of 20 ms under feedback",
        ),
    ),
    SafetyRequirement(
        "SR-29", "Another program that sends wrong goals, or none, ends in a controlled stop.",
        (
            f"{_T}/goals/test_outside_goals.py::"
            "test_what_is_wrong_with_the_program_ends_in_a_controlled_stop",
        ),
        ("program that sends the goals",),
    ),
    SafetyRequirement(
        "SR-30", "A servo that repeats its measurement although its goal moves stops the robot.",
        (
            f"{_T}/safety/test_frozen_feedback.py::test_a_repeated_sample_stops_a_moving_robot",
            f"{_T}/safety/test_frozen_feedback.py::test_a_live_servo_is_never_taken_for_frozen",
        ),
        ("frozen feedback",),
    ),
)  # fmt: skip
"""All requirements, in the order of the page."""


def rows_of(requirement: SafetyRequirement) -> Iterator[str]:
    """Yield the names of the faults that verify a requirement."""
    names = dict.fromkeys(row.fault for row in ROWS)
    for pattern in requirement.faults:
        yield from (name for name in names if fnmatchcase(name, pattern))
