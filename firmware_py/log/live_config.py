"""Configuration of the live view."""

from __future__ import annotations

from typing import Final

import msgspec

__all__ = ["ORIGINS", "VIEWERS", "LiveConfig"]

ORIGINS: Final = ("https://app.foxglove.dev", "file://")
"""Origins of Foxglove: its web page and its desktop program. Programs that are not browsers send no
origin and are admitted."""
VIEWERS: Final = 8


class LiveConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Table `[live]`: address at which `dropstitch run --live` serves the ticks to Foxglove."""

    # Address to listen on. Whoever can reach it sees the ticks, but cannot command the robot.
    host: str = "127.0.0.1"
    port: int = 8765  # TCP port; 0 chooses a free one
    origins: tuple[str, ...] = ORIGINS  # Web sites whose pages may connect
    viewers: int = VIEWERS  # Largest number of viewers
