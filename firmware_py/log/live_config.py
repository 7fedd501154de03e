"""Configuration of the live view."""

from __future__ import annotations

from typing import Final

import msgspec

__all__ = ["ORIGINS", "VIEWERS", "LiveConfig"]

ORIGINS: Final = ("https://app.foxglove.dev", "file://")
"""Origins of Foxglove: its web page, and its desktop program. A program that is no browser sends no
origin and is admitted."""
VIEWERS: Final = 8


class LiveConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[live]`: address at which `dropstitch run --live` serves the ticks to Foxglove."""

    # Address to listen at. Who can reach it sees the ticks, but cannot command the robot.
    host: str = "127.0.0.1"
    port: int = 8765  # TCP port; 0 takes any that is free
    origins: tuple[str, ...] = ORIGINS  # Web sites whose pages may connect
    viewers: int = VIEWERS  # Largest number of viewers
