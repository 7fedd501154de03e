"""Causes of wrong recordings: limit, sentence and remedy of each, in the order of an import.

A check measures, and yields a cause from this table with what it measured. A pair of limits warns
beyond its first number and refuses beyond its second. Unless a comment says otherwise the limits
are [assumed]: markers are placed by hand to about 1 mm, the link leans by up to 1.5° at rest
(prebend, payload), and a wrong frame shifts the tip by its offset, or by 17 mm per degree.
"""

from __future__ import annotations

import math
import string
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py.core.units import ANGLE, DURATION, LENGTH

Level = Literal["refused", "warning"]


class ImportFinding(NamedTuple):
    """An error or a doubt about a recording."""

    level: Level  # How serious it is
    cause: str  # Kind of the cause, one word or two: `yaw`, `origin`, `swapped`, …
    text: str  # What was observed, with its likely cause
    remedy: str  # What the user can do, as an imperative


def listed(words: Sequence[str]) -> str:
    """Words as a sentence lists them: "a, b and c"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


class _Sentences(string.Formatter):
    """Formatter of SI values in the usual units, `{angle_rad:deg}`, of lists and vectors."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec == "listed":
            return listed(value)
        if format_spec == "vector":
            return ", ".join(f"{round(float(v), 2) + 0.0:g}" for v in value)  # without -0
        for name, unit in (("deg", ANGLE), ("mm", LENGTH), ("ms", DURATION)):
            if format_spec.startswith(name):
                decimals = format_spec.removeprefix(name)
                return unit.text(value, int(decimals) if decimals else None)
        return format(value, format_spec)


_SENTENCES: Final = _Sentences()


def at_rows(rows: NDArray[np.intp], time_s: NDArray[np.float64], noun: str = "row") -> str:
    """Rows of a trial in words, counted as in its file, whose header is row 1.

    With `noun` "sample", samples of a recording, counted from 1.
    """
    first, last = int(rows[0]), int(rows[-1])
    header = 2 if noun == "row" else 1
    if first == last:
        return f"{noun} {first + header} ({time_s[first]:.2f} s)"
    of = "" if len(rows) == last - first + 1 else f"{len(rows)} of the "
    times = f"({time_s[first]:.2f} s to {time_s[last]:.2f} s)"
    return f"{of}{noun}s {first + header} to {last + header} {times}"


WARNS: Final = (-math.inf, math.inf)
"""Limits of a cause that warns whatever its size."""
REFUSES: Final = (-math.inf, -math.inf)


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong; `text` and `remedy` have fields for the measured values."""

    name: str
    limits: tuple[float, float]
    text: str
    remedy: str

    def level(self, size: float) -> Level | None:
        """Level of a measured size by the limits; None within both."""
        warned, refused = self.limits
        return "refused" if abs(size) > refused else "warning" if abs(size) > warned else None

    def at(self, level: Level, **measured: Any) -> ImportFinding:
        text, remedy = (_SENTENCES.vformat(s, (), measured) for s in (self.text, self.remedy))
        return ImportFinding(level, self.name, text, remedy)

    def raised(self, **measured: Any) -> list[ImportFinding]:
        """The finding, of a cause that is not a matter of size."""
        return self.beyond(0.0, **measured)

    def beyond(self, size: float, **measured: Any) -> list[ImportFinding]:
        """The finding if a size is beyond the limits; the sentence may use it as `size`."""
        level = self.level(size)
        return [self.at(level, size=size, **measured)] if level else []


# fmt: off

# Markers that a file lacks, hides or holds.

ABSENT_MARKER = Cause("absent", REFUSES,
    "{name} is mapped to {source!r}, which the file does not hold",
    "correct [markers] in MAP.toml")
NOT_MAPPED = Cause("absent", WARNS,
    "the file holds no {names:listed}: there is no Deformation Index without",
    "map them under [markers], or use the plant without DI")
OCCLUDED = Cause("occluded", (0.2, 0.8),  # fraction of the rows
    "{name} is occluded in {size:.0%} of the rows",
    "check its name, or record it again with the marker in view")
ZEROS = Cause("zeros", WARNS,
    "markers are at exactly 0, 0, 0 between {first_s:.2f} s and {last_s:.2f} s ({counts:listed} "
    "samples), as some exports write an occlusion: these samples are left out",
    "leave these cells empty where the marker was hidden, and compute the tip there from the other "
    "markers of its row")
HELD = Cause("held", WARNS,
    "the position of {names:listed} is constant in {rows}, while {meanwhile} by {moved_m:mm0}",
    "leave these cells empty where the marker was occluded")
EXCHANGED = Cause("swapped", WARNS,
    "{what} in {rows}", "exchange them in these rows and correct the tip")
OUT_OF_PLACE = Cause("place", WARNS,
    "the place of {what} is wrong in {rows}: distances to the neighbours are off by up to "
    "{off_m:mm0}",
    "leave these cells empty, or label the markers again and export anew")

# Pose at rest.

ORDER = Cause("swapped", REFUSES,
    "{order}", "correct [markers] in MAP.toml")
MIRROR_OR_ORDER = Cause("swapped", REFUSES,
    'with mirror = "{mirror}" the axes are left-handed, or the {order}, the other way round',
    "leave mirror out of [frame], or correct [markers] in MAP.toml")
LEFT_HANDED = Cause("swapped", REFUSES,
    "the file's axes are left-handed (one axis is mirrored), or the {order}, the other way round",
    'set mirror = "{axis}" under [frame]; correct [markers] only where the names really are in '
    "that order")
SCALE = Cause("scale", (0.015, 0.05),  # relative error of the distances
    "the markers' distances are {scale:.4g} times those of the link{unit}",
    "correct link_length_m and link_width_m, or the unit of length")
ROW_SPACING = Cause("scale", SCALE.limits,
    "the rows of markers are {ratio:.4g} times as far apart as those of the link, the corners "
    "{other:.4g} times",
    "correct link_length_m (it fits at {fits_m:.3f} m), or the heights of the rows")
CORNER_SPACING = Cause("scale", (0.06, 0.3),  # markers sit a little inside of the edges
    "the corners of a row are {ratio:.4g} times as far apart as those of the link, the rows "
    "{other:.4g} times",
    "correct link_width_m (it fits at {fits_m:.3f} m), or the places of the corners")
SAG = Cause("sag", WARNS,
    'align = "rest" takes the link for straight, but at rest it sags by about {sag_m:mm0}',
    'align by the base\'s markers, or give the frame with align = "none"')
UP_AXIS = Cause("up axis", REFUSES,
    "the file is {up}-up: the link points along its {up} axis, the map takes {now} for up",
    'set up = "{up}" under [frame]')
CORNERS_TURNED = Cause("yaw", (0.035, 0.105),  # rad: 2° and 6°
    "the corners of the link are turned by {size:deg} about the vertical",
    "set yaw_deg = {yaw_deg:.1f} under [frame], or correct the order of the corners")
TILT = Cause("tilt", (0.0262, 0.087),  # rad: 1.5° and 5°
    "the link leans by {tilt_rad:deg} at rest, which puts its tip {aside_m:mm0} aside: a prebend "
    "of the link, a tilted frame, or an encoder's zero",
    'level the motion capture\'s frame, or map markers of the base and set align = "base"')
REMOVED_LEAN = Cause("lean", (0.008, math.inf),  # m at the tip
    'align = "rest" takes away a lean of {lean}: a prebend of the link, or a tilted frame',
    'to keep a prebend, map markers of the base and set align = "base", or give the frame with '
    'align = "none"')
LEANS_AGAINST = Cause("sign", REFUSES,
    "the link leans by {tilt_rad:deg} against its angles at rest, and not at all against these "
    "with the other sign: the servo counts the other way",
    "set scale = -1.0 for the angle and its goal, or correct up, mirror and yaw_deg")
ZERO = Cause("zero", REFUSES,
    "angle_{joint}_rad reads {rest_rad:deg} at rest, where the link stands at zero: the encoder's "
    "zero is elsewhere",
    "set offset = {offset_rad:.4f} for angle_{joint}_rad and goal_{joint}_rad in MAP.toml")
ORIGIN = Cause("origin", (0.008, 0.025),  # m, from the crossing of the joint axes
    "the origin is {height_m:.3f} m too {way} and {aside_m:.3f} m aside ({off_m[0]:+.3f}, "
    "{off_m[1]:+.3f})",
    "set origin_m = [{new_m[0]:.3f}, {new_m[1]:.3f}, {new_m[2]:.3f}] under [frame] (correct the "
    "tilt first if there is one), or correct base_offset_m")
SHAPE = Cause("shape", (0.006, 0.015),  # m, after the best rigid motion
    "{name} is {size:mm0} from its place on the link",
    "check its name under [markers], its place, and the size of the link")
BASE_ORDER = Cause("base", REFUSES,
    "by the base's markers the link leans by {tilt_rad:deg}, is turned by {yaw_rad:deg} and is "
    "{off_m:.3f} m off",
    "correct b01 … b04 under [markers]: the corners (+x, +y), (-x, +y), (+x, -y), (-x, -y) of the "
    "base plate")
REST_ROWS: Final = (20, 2)
"""Rows at rest; fewer than the first warn, fewer than the second refuse."""
SHORT_REST = Cause("rest", WARNS,
    "{rest} rows at rest before the motion, the reference of the Deformation Index",
    f"start both recordings at least {REST_ROWS[0]} rows before the motion")
REST_MOVES = Cause("rest", (0.003, 0.010),  # m
    "a marker moves by {size:mm} within the {rest} rest rows",
    "correct rest_samples, or let the link come to rest first")

# The base plate while the joints move.

FIXED_BASE = Cause("base", REFUSES,
    "the base's markers move by {moved_m:mm} only, where a plate that turns with the link moves by "
    "{due_m:mm0}: they are on a fixed stand",
    'leave b01 … b04 out of [markers], and set align = "rest" or "none" under [frame]')
BASE_OFFSET = Cause("base offset", (0.004, 0.012),  # m
    "the base's markers move on circles about axes {fits_m:.3f} m below the base plate, "
    "base_offset_m says {stated_m:.3f} m",
    "set base_offset_m = {fits_m:.3f}, in link.toml too")
ROOT_PATH = Cause("base offset", (0.010, math.inf),  # m
    "the first marker row moves as on a base plate {fits_m:.3f} m above the joint axes, "
    "base_offset_m says {stated_m:.3f} m",
    "measure it, and correct base_offset_m or the place of the first row")

# Times, steps and clocks.

TIME_UNIT = Cause("time", REFUSES,
    "the samples of {file} are {step_s:.3g} s apart: its times have another unit",
    'set unit = "{unit}" for time_s in MAP.toml')
FRAME_NUMBERS = Cause("time", REFUSES,
    "the times of {file} are whole numbers one apart: they count frames, or ms",
    'map the column of the times, or set scale = 1 over the frame rate, or unit = "ms", for time_s '
    "in MAP.toml")
STEP = Cause("step", WARNS,
    "the samples of {file} are {file_s:ms} apart and the trial's rows {step_s:ms}: its goals are "
    "held from sample to sample and come late or early",
    "record the servos at the robot's period; if that is {file_s:ms}, set step_s = {file_s:.4g} "
    "above the tables of MAP.toml: the step of the trials becomes the period of the bundle")
GAP = Cause("gap", (0.035, 0.1),  # s without a sample: two periods of a motion below 4 Hz
    "{file} has no samples for {size:.3f} s from {start_s:.2f} s on",
    "cut the recording there, or record it again")
CLOCK_ERROR = Cause("clock", (0.002, 0.02),  # s, half of the interval; the tip moves at 0.7 m/s
    "the clock's offset is known to ±{size:ms} only",
    "map m01 to m08, record more motion, or record a sync signal in both files")
CLOCK_DRIFT = Cause("clock", (0.002, math.inf),  # s
    "the two clocks drift apart by {size:ms} in {over_s:.1f} s",
    "correct the frame rate of the motion capture, or record shorter takes")
FRAME_RATE = Cause("rate", REFUSES,
    "angle and motion fit (correlation {correlation:.3f}) once the times of {file} are multiplied "
    "by {factor:.4g}: the frame rate of one of the files is wrong",
    "correct the frame rate, as with scale = {factor:.4g} for time_s in MAP.toml, or export the "
    "motion capture again")
CLOCK_OPTION = Cause("clock", (0.002, math.inf),  # s, beyond three half widths
    "the offset set by hand, {option_s:.4f} s, differs by {differs_s:ms} from that of the {by}, "
    "{estimate_s:.4f} s ± {error_s:ms2}",
    "leave out --offset (offset_s in a table of takes), or correct it")
COMMON_CLOCK = Cause("clock", (0.01, 0.05),  # s between markers and angles of one file
    "the markers are {size:.3f} s {late} against the angles",
    "import the recordings again, the angles as a second file with --servo; dropstitch gap names "
    "an offset that stays (sync_offset)")

# Signals of the servo.

SHARED_SIGNAL = Cause("twice", WARNS,
    "{names:listed} in {servo} and in {mocap} differ: what {servo} holds is used",
    "leave it out of the file that is wrong")
DOUBLED_SIGNAL = Cause("doubled", REFUSES,
    "{one} and {other} hold the same values", "map each to its own column")
GOAL_FROM_ANGLE = Cause("goal", WARNS,
    "goal and angle of joint {joint} are both taken from {source!r}: the servo's own error is lost",
    "map the goals, or say in 'notes' under [trial] that they were not logged")
STUCK = Cause("stuck", (0.03, 0.1),  # rad of the goal; a servo with stiction lags by less
    "angle_{joint}_rad does not change for {still_s:ms} from {first_s:.2f} s on, while its goal "
    "moves by {size:deg}",
    "check torque and current limit of the servo, or cut the recording there")
WRAP = Cause("wrap", REFUSES,
    "{name} jumps by {jump:deg} after {where}: its count starts again after a turn",
    "write it without jumps: where it counts from 0 to 360 deg, subtract 360 deg above 180 deg")
ANGLE_SPIKE = Cause("spike", WARNS,
    "{name} jumps by {jump:deg} and back in {where}: no joint moves like that",
    "correct the sample by its neighbours, or cut the recording there")
CURRENT_SPIKE = Cause("spike", WARNS,
    "{name} jumps to {jump:.3g} A and back in {where}, the others lie between {low:.3g} and "
    "{high:.3g} A",
    "correct the sample by its neighbours: one such sample changes a fit")
DEGREES = Cause("unit", REFUSES,
    "{name} reaches {reached:.3g}: it is in deg", 'set unit = "deg" for {name} in MAP.toml')
COUNTS = Cause("unit", REFUSES,
    "{name} reaches {reached:.3g}: it is in counts of the encoder",
    "set scale = 0.0015339 (4096 counts per turn) and offset for {name} in MAP.toml")
MILLIAMPERES = Cause("unit", REFUSES,
    "{name} reaches {reached:.3g}: it is in mA, or in counts of the servo",
    'set unit = "mA", or the servo\'s A per count as scale, for {name} in MAP.toml')
SMALL_CURRENT = Cause("unit", WARNS,
    "current {joint} reaches {reached_a:.2g} A only, less than friction takes: its unit is wrong",
    "correct unit or scale of current_{joint}_a")
SIGN = Cause("sign", REFUSES,
    "joint {joint} counts the other way: its angle and the link's direction correlate by "
    "{correlation:.2f}",
    "set scale = -1.0 for angle_{joint}_rad and its goal, or mirror under [frame] for a "
    "left-handed file")
JOINTS_SWAPPED = Cause("joints", REFUSES,
    "joints 1 and 2 are swapped",
    "exchange them under [columns] or in 'joints' of MAP.toml")
SECOND_JOINT = Cause("joints", (0.1, 0.3),  # across the joint's plane, relative to in it
    "the link moves in two directions, {size:.0%} across the plane of its only joint",
    "set dof = 2 and map the second servo, or hold the second joint still")
IDLE_JOINT = Cause("joints", WARNS,
    "joint {joint} does not move, dof says 2",
    "set dof = 1 where only joint 1 moved, or map the angle and goal of joint {joint}")
MOVED_ASIDE = Cause("yaw", CORNERS_TURNED.limits,  # rad: 2° and 6°
    "the link moves {size:deg} beside the plane of joint 1",
    "correct yaw_deg under [frame], or the order of the corners")
GAIN = Cause("gain", (0.15, 0.3),  # deviation from one; the bend adds 0.1 at 2 kg
    "the link turns {gain:.3g} times as far as the angle says{unit}",
    "check the angle's unit, the gear ratio, base_offset_m, and that the log is of this take")
GOAL_AGAINST = Cause("goal", REFUSES,
    "goal and angle of joint {joint} run against each other",
    "correct the sign of angle_{joint}_rad")
GOAL_FACTOR = Cause("goal", REFUSES,
    "goal and angle of joint {joint} differ by a factor of {factor:.3g}",
    "correct the unit of goal_{joint}_rad")
GOAL_BEHIND = Cause("goal", WARNS,
    "angle_{joint}_rad moves {lead_s:ms} before goal_{joint}_rad: no servo knows its goal before, "
    "so the two columns are exchanged or the goals come from another clock",
    "exchange them in MAP.toml, or correct the times of the goals")
AMPLITUDE = Cause("amplitude", (0.3, math.inf),  # relative difference; only a warning
    "the goals reach {reach_rad:deg}, amplitude_rad says {stated_rad:deg}",
    "correct amplitude_rad under [trial]")
CURRENTS_SWAPPED = Cause("current", WARNS,
    "currents 1 and 2 are swapped", "exchange their columns in MAP.toml")
CURRENT_SIGN = Cause("current", WARNS,
    "current {joint} brakes where it should drive: its sign is turned",
    "set scale = -1.0 for current_{joint}_a")
CURRENT_SIZE = Cause("current", WARNS,
    "current {joint} is never negative although the joint turns both ways: it is a magnitude, or "
    "negative values were read as large positive ones",
    "log the signed current, or leave trials without it out of a fit")

# Goals and conditions.

STILL_GOAL = Cause("goal", REFUSES,
    "angle_{joint}_rad moves by {moved_rad:deg} while goal_{joint}_rad stands still within "
    "{goal_rad:deg}",
    "give the goals that were sent, or set amplitude_rad = 0 where the joint was moved by hand")
STILL_GOALS = Cause("amplitude", WARNS,
    "the goals stand still, amplitude_rad says {stated_rad:deg}",
    "correct amplitude_rad, or give the goals that were sent")
MISSING_ROWS = Cause("gap", WARNS,
    "goal_{joint}_rad and angle_{joint}_rad jump together by {jump:deg} in row {row} "
    "({at_s:.2f} s), no angle follows its goal so fast: rows are missing before it",
    "give the rows that are missing with their own times, or cut the trial there")
NO_SINUSOID = Cause("period", WARNS,
    "the goals are no sinusoid with the period of {period_s:g} s",
    "correct period_s or motion under [trial]")
PERIOD = Cause("period", (0.005, math.inf),  # relative difference; only a warning
    "the goals repeat after {period_s:.3f} s, period_s says {stated_s:.3f} s: the time step or "
    "period_s is wrong by {size:.1%}",
    "correct period_s, or the step and the unit of the times")
MOTION = Cause("motion", WARNS,
    "the goals are a sinusoid of {period_s:.3f} s, motion says {motion!r}",
    'set motion = "sinusoid"')
PHASE = Cause("phase", (0.3, math.inf),  # rad; only a warning
    "goal 2 leads goal 1 by {lead_rad:deg0}, phase_2_rad says {stated_rad:deg0}",
    "set phase_2_rad = {lead_rad:.4g} under [trial], or correct the sign of a goal")
CONDITIONS = Cause("conditions", REFUSES,
    "[conditions] names {names:listed}, which no plant of the link declares",
    "take [conditions] out, which is for plants with [signals]; conditions of the link, such as "
    "payload_kg, stand above it")
GRAVITY_SIZE = Cause("gravity", REFUSES,
    "gravity_m_s2 is [{stated:vector}], {size_m_s2:.3g} m/s²: a wrong unit, such as g",
    "leave it out for an upright link, or give the direction with 9.81 m/s²")
GRAVITY_LOW = Cause("gravity", WARNS,
    "gravity_m_s2 is [{stated:vector}], {size_m_s2:.3g} m/s²: right only where a balloon carries "
    "the rest of the weight (effective_weight in link.toml)",
    f"otherwise {GRAVITY_SIZE.remedy}")
GRAVITY_DIRECTION = Cause("gravity", WARNS,
    "current {joint} holds a weight that pulls along [{shown:vector}], gravity_m_s2 is "
    "[{stated:vector}]",
    "correct gravity_m_s2 (leave it out for an upright link), or the signs of angle_{joint}_rad "
    "and current_{joint}_a")

# The tip.

TIP_REACH = Cause("tip", REFUSES,
    "the tip is {size_m:.3g} m from the joint axes, the end of the link {reach_m:.3g} m{unit}",
    "correct the unit or place of tip (tip_x_m, tip_y_m, tip_z_m), or link_length_m")
TIP_PLACE = Cause("tip", SHAPE.limits,
    "the tip is {size:mm} from the centre of the last marker row ({row}){cause}",
    "correct tip in [markers] of the map (the pivot of its rigid body), or leave it out to have it "
    "computed, and import again")
TIP_PART = Cause("tip", (math.inf, 0.1),  # fraction of the rows; fewer are outliers
    "the tip is beyond {limit_m:mm0} from the centre of the last marker row ({row}) in {size:.0%} "
    "of the rows", TIP_PLACE.remedy)
TIP_ROWS = Cause("tip", WARNS,
    "the tip is up to {off_m:mm0} from the centre of {row} in {where}",
    "correct the tip there: the centre of {row}, or interpolate it")
TIP_JUMPS = Cause("tip", WARNS,
    "the tip is off its course in {where}", TIP_ROWS.remedy)

# What several trials hold together.

SAME_PAYLOAD = Cause("payload", WARNS,
    "{low} and {high} are both of {payload_kg:g} kg, but the {signal} shows {ratio:.2f} times the "
    "load in the second", "correct payload_kg where it is wrong")
LESS_LOAD = Cause("payload", WARNS,
    "the {signal} shows less load in the trials of {payload_kg:g} kg than in those of "
    "{less_kg:g} kg", SAME_PAYLOAD.remedy)
PAYLOAD_BETWEEN = Cause("payload", WARNS,
    "the {signal} shows {shown_kg:.2g} kg in the trials of {payload_kg:g} kg, by those of "
    "{around_kg[0]:g} and {around_kg[1]:g} kg", SAME_PAYLOAD.remedy)
SERVO_LOG = Cause("servo log", WARNS,
    "{contradiction}, while the link's bend fits the payloads: a servo log belongs to another take",
    "import the takes again, each with its own servo log")
PAYLOAD_SIZE = Cause("payload unit", (2.0, 5.0),  # moment relative to that which folds the link
    "a payload of {payload_kg:g} kg would load the link's root with {moment_nm:.3g} N.m, which "
    "folds it at {limit_nm:.3g} N.m: payload_kg is in another unit",
    "give payload_kg in kg: 500 g are 0.5 kg, 2 lb 0.907 kg, 10 N 1.02 kg")
PAYLOAD_UNIT = Cause("payload unit", WARNS,
    "the load of the joint grows by {factor:.3g} ± {error:.2g} kg per kg of payload_kg: the "
    "payloads seem to be {unit}",
    "give payload_kg in kg in every trial")
TORQUE_CONSTANT = Cause("torque constant", WARNS,
    "the current is {factor:.3g} times what the weight of link and payloads needs: the plant's "
    "torque constant is not the servo's, or the current has another unit",
    "give the torque constant of your servo in link.toml, or correct the unit of the current")
LINK_SIZE = Cause("size", REFUSES,
    "{key} differs between the trials: {listed}",
    "keep the trials of each link in a directory of their own")
PRESSURES = Cause("pressure", WARNS,
    "pressure_pa differs between the trials: {low:g} to {high:g} Pa, and the stiffness grows with "
    "it",
    "fit a plant or a predictor to the trials of one pressure")
COPY = Cause("doubled", WARNS,
    "{first} and {second} hold the same angles or are of one recording",
    "import each recording once; a copy is no test")
NO_TEST = Cause("held out", WARNS,
    "no trial is left to test on",
    "record a second trial of each payload before a plant or a predictor is fitted to these")
NOT_FITTED = Cause("held out", WARNS,
    "nothing is fitted to {payloads:listed}: smaller amplitude only",
    "record these payloads with the largest amplitude too, or use them as a test")
TOGETHER = Cause("joints", WARNS,
    "both joints move together in every trial",
    "to train a predictor, record a trial in which one joint leads the other; identify and gap "
    "need none")
# fmt: on
