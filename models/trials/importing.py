"""Import of recordings as trials: one file, several, or a folder, with one map.

Every import is checked against the nominal link and gets a page, OUT/NAME.html, that shows the
findings. An import replaces only trials of the same recordings: neither a file that is read nor
any other trial.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import MOST_BYTES
from firmware_py.core.units import DURATION
from models.shared.output_paths import check_output_directory
from models.trials.files import PlantSignals, check_trial_name, read_trial
from models.trials.guarded_call import SECONDS, guarded_call
from models.trials.pipeline import import_take
from models.trials.recordings.mapping import RecordingMap, Take, find_takes, read_mapping
from models.trials.trial import Trial

SECONDS_PER_BYTE: Final = 2e-6
"""Processor time by the size of a recording: five times that of a bag of joint states
[measured]."""


@dataclass(frozen=True, repr=False)
class ImportedTake:
    """One recording that `import_recordings` imported or refused.

    Attributes
    ----------
    file : Path
        The recording.
    facts : dict of str to Any
        Facts about the import, as `dropstitch import --json` prints them.
    signals : mapping of str to SignalRole
        Signals of the plant that the map names; empty for the link.

    Examples
    --------
    >>> ImportedTake(Path("take.csv"), {"verdict": "refused", "why": "take.csv: is empty; record."})
    <ImportedTake take.csv: refused: take.csv: is empty; record.>
    """

    file: Path
    facts: dict[str, Any]
    signals: PlantSignals = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<ImportedTake {self.file.name}: {self.summary()}>"

    @property
    def refused(self) -> bool:
        """Whether the recording cannot be right, so that there is no trial."""
        return bool(self.facts["verdict"] == "refused")

    def trial(self) -> Trial:
        """Read the trial that was written."""
        if self.refused:
            raise InputError(self.file, "was refused", "see summary() for the reason")
        return read_trial(self.facts["trial"], self.signals)

    def warnings(self) -> list[str]:
        """Return the findings that make the trial doubtful, one sentence each."""
        return [f"{f['text']}; {f['remedy']}" for f in self.facts.get("findings", ())]

    def summary(self) -> str:
        """Return rows, step, rest and clock of the trial, or why it was refused."""
        facts = self.facts
        if self.refused:
            return f"refused: {facts['why']}"
        text = (
            f"{facts['trial']}: {facts['rows']} rows of "
            f"{DURATION.factor * facts['step_s']:.3g} ms, {facts['rest_samples']} at rest"
        )
        if facts["occluded_share"] is not None:
            text += f", {facts['occluded_share']:.1%} of the marker cells empty"
        for key in ("clock", "lean"):
            text += f"; {facts[key]}" if key in facts else ""
        for name in facts["cut_off"]:
            text += f"; {name} was cut off: read up to its last whole chunk"
        warned = len(facts["findings"])
        return f"{text}; {warned or 'no'} warning{'s' if warned != 1 else ''}, see {facts['page']}"


def import_recordings(
    files: Path | str | Sequence[Path | str],
    kind: str,
    out: Path | str,
    *,
    mapping: Path | str | RecordingMap | None = None,
    servo: Path | str | None = None,
    offset_s: float | None = None,
    name: str = "",
) -> list[ImportedTake]:
    """Import recordings as trials: names and units mapped, files merged, clocks synchronised.

    Parameters
    ----------
    files : Path, str or sequence of them
        Recordings, or their folder.
    kind : {"motive", "c3d", "rosbag", "recording", "table"}
        Format of the recordings.
    out : Path or str
        Directory of the trials.
    mapping : Path, str or RecordingMap, optional
        MAP.toml: names, units, frame and conditions; by default the columns have the names of a
        trial.
    servo : Path or str, optional
        Second file with angle, current and goal: a log of the robot, or a table.
    offset_s : float, optional
        Offset that is added to the times of `servo`; by default it is estimated by correlation.
    name : str
        Name of the trial; by default that of the file.

    Returns
    -------
    list of ImportedTake
        One for each recording. Of several, some may be refused.

    Raises
    ------
    InputError
        If the only recording is refused, a file is missing, or an output would replace an input.

    Examples
    --------
    A table whose angles are in degrees; the map adds what it lacks:

    >>> from pathlib import Path
    >>> import dropstitch, numpy as np
    >>> case = dropstitch.TrialCase(dropstitch.Motion(), payload_kg=1.0, trial=1)
    >>> run = dropstitch.run_case(dropstitch.rig_named("default"), case)
    >>> measured = dropstitch.trial_frame(run)
    >>> measured["servo_deg"] = np.degrees(measured.pop("angle_1_rad"))
    >>> measured.to_csv("take_001.csv", index=False)
    >>> _ = Path("map.toml").write_text('''
    ... [trial]
    ... dof = 1
    ... payload_kg = 1.0
    ... pressure_pa = 41300.0
    ... trial = 1
    ... motion = "sinusoid"
    ... period_s = 4.352
    ... amplitude_rad = 0.5236
    ... base_offset_m = 0.06
    ... link_length_m = 0.95
    ... link_width_m = 0.15
    ... [columns]
    ... angle_1_rad = { from = "servo_deg", unit = "deg" }
    ... ''')
    >>> takes = dropstitch.import_recordings("take_001.csv", "table", "trials", mapping="map.toml")
    >>> takes[0].trial()
    <Trial take_001: 1 joint, sinusoid, 1 kg, 572 rows of 17 ms>
    """
    sources = [files] if isinstance(files, (str, Path)) else files
    map_path = Path(mapping) if isinstance(mapping, (str, Path)) else None
    known = mapping if isinstance(mapping, RecordingMap) else read_mapping(map_path)
    takes = find_takes([Path(file) for file in sources], kind, known)
    directory = Path(out)
    if len(takes) == 1:
        (take,) = takes
        if servo is not None:
            take = take._replace(servo=Path(servo))
        if offset_s is not None:
            take = take._replace(offset_s=offset_s)
        takes, names = [take], [name or take.file.stem]
    else:
        for option, value in (("servo", servo), ("name", name or None), ("offset", offset_s)):
            if value is not None:
                raise InputError(
                    f"--{option}", f"belongs to one file, not to {len(takes)}",
                    "give it under [takes]",
                )  # fmt: skip
        names = [take.file.stem for take in takes]
    _check_replaced(takes, known, map_path, directory, names)
    results = []
    for take, trial_name in zip(takes, names, strict=True):
        try:
            facts = _import(take, kind, directory, trial_name)
        except InputError as error:
            if len(takes) == 1:
                raise
            facts = {"file": str(take.file), "verdict": "refused", "why": str(error)}
        results.append(ImportedTake(take.file, facts, known.signals))
    return results


def _check_replaced(
    takes: Sequence[Take],
    mapping: RecordingMap,
    map_path: Path | None,
    out: Path,
    names: Sequence[str],
) -> None:
    """Refuse, before any work, an output that would replace an input."""
    inputs = [*(take.file for take in takes), *(take.servo for take in takes), map_path]
    if map_path is not None:
        beside = (mapping.link, mapping.plant, mapping.takes.table)
        inputs += [map_path.parent / name for name in beside if name]
    written = [f"{name}{suffix}" for name in names for suffix in (".csv", ".toml", ".html")]
    check_output_directory(out, written, filter(None, inputs))


def _import(take: Take, kind: str, out: Path, name: str) -> dict[str, Any]:
    """Import one take in a child process with limits of memory and time.

    Libraries that read binary formats crash or allocate without bound on damaged files.
    """
    check_trial_name(name, "--name")
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".import-", dir=out) as scratch:
        answer = guarded_call(
            lambda: msgspec.json.encode(import_take(take, kind, name, out, Path(scratch))),
            take.file, "export it again, or import less of it", seconds=_seconds_for(take),
        )  # fmt: skip
        facts: dict[str, Any] = msgspec.json.decode(answer)
        for file in sorted(Path(scratch).iterdir()):  # the CSV first: a trial needs both
            file.replace(out / file.name)
    return facts


def _seconds_for(take: Take) -> float:
    """Limit of the processor time for files of this size; unreadable files are refused later."""
    size = 0
    for path in filter(None, (take.file, take.servo)):
        with contextlib.suppress(OSError, ValueError):
            files = path.iterdir() if path.is_dir() else (path,)
            size += sum(file.stat().st_size for file in itertools.islice(files, 100))
    return SECONDS + min(size, 2 * MOST_BYTES) * SECONDS_PER_BYTE
