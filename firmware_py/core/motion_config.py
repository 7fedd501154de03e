from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Final

import msgspec

from firmware_py.core.documents import Document, check_version
from firmware_py.core.errors import InputError
from firmware_py.core.input_files import convert, read_toml
from firmware_py.core.motion import KINDS, STUDY_AMPLITUDE_RAD, STUDY_PERIOD_S, Kind, Motion
from firmware_py.core.motion_document import MotionDocument, read_motion_document

__all__ = ["FixedMotionDocument", "MotionConfig"]

_MAKE: Final = "write it anew with dropstitch experiment"


class FixedMotionDocument(Document, frozen=True):
    """Motion file with a kind of motion: its keys stand for those of the table `[motion]`."""

    MADE_BY: ClassVar[str] = "dropstitch experiment"

    kind: Kind
    amplitude_rad: float
    period_s: float
    phase_2_rad: float = 0.0
    payload_kg: float | None = None  # Payload to attach for the run
    notes: str = ""


class MotionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[motion]`: the reference motion, see `firmware_py.core.motion`."""

    kind: Kind = "sinusoid"  # Kind of motion, see `firmware_py.core.motion`
    amplitude_rad: float = STUDY_AMPLITUDE_RAD  # Largest goal of each joint
    period_s: float = STUDY_PERIOD_S  # Time of one cycle of the sinusoid
    phase_2_rad: float = 0.0  # Phase by which joint 2 leads joint 1
    rest_s: float = 1.0  # Rest before the motion, the reference of the Deformation Index
    # Motion file, relative to robot.toml, instead of kind, amplitude, period and phase
    file: str | None = None
    design: MotionDocument | None = None  # Fourier series of the motion file

    def motion(self, dof: int) -> Motion:
        """Return the motion for a number of joints."""
        if self.design is None:
            return Motion(self.kind, self.amplitude_rad, self.period_s, self.phase_2_rad, dof)
        if len(self.design.joints) != dof:
            raise InputError(
                f"motion {self.design.name}",
                f"has {len(self.design.joints)} joints, the robot {dof}",
                "give one for this robot",
            )
        return Motion.designed(self.design)

    def with_motion(self, wanted: str) -> MotionConfig:
        """Return the table for another motion: the name of a kind, or the path of a motion file."""
        if wanted in KINDS:
            kind = msgspec.convert(wanted, Kind)
            return msgspec.structs.replace(self, kind=kind, file=None, design=None)
        if not Path(wanted).exists():
            raise InputError(
                f"motion {wanted}", "is no kind of motion and no file",
                "choose " + ", ".join(KINDS) + " or a motion file",
            )  # fmt: skip
        return self.with_file(Path(wanted))

    def with_file(self, path: Path) -> MotionConfig:
        """Return the table for a motion file: of a kind of motion, or of a Fourier series."""
        raw = read_toml(path, _MAKE, _MAKE)
        if "kind" not in raw:
            series = read_motion_document(path)
            return msgspec.structs.replace(self, file=str(path), design=series)
        check_version(path, raw, FixedMotionDocument.VERSION, _MAKE)
        document = convert(raw, FixedMotionDocument, path, "is no motion", _MAKE)
        motion = msgspec.structs.replace(
            self, kind=document.kind, amplitude_rad=document.amplitude_rad,
            period_s=document.period_s, phase_2_rad=document.phase_2_rad, file=None, design=None,
        )  # fmt: skip
        try:
            motion.motion(1)
        except InputError as error:
            raise InputError(path, f"its {error.where} {error.what}", error.remedy) from None
        return motion
