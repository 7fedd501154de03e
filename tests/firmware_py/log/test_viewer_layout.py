"""Layout for the viewer beside what a log holds."""

import json
import re
from pathlib import Path

from firmware_py.core.signals import tick_signals
from firmware_py.log.recording import TOPIC
from firmware_py.log.scene import FRAME, SCENE_TOPIC

LAYOUT = Path(__file__).parents[3] / "docs" / "files" / "foxglove-layout.json"


def panels(node):
    """Panels of a layout, left to right."""
    return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])


def test_the_layout_shows_the_scene_and_signals_that_a_log_has():
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    view = layout["configById"]["3D!link"]
    assert view["topics"] == {SCENE_TOPIC: {"visible": True}}
    assert view["followTf"] == FRAME
    known = {f"{TOPIC}.{signal.name}" for signal in tick_signals(2)}
    assert set(re.findall(r'"value": "([^"]+)"', LAYOUT.read_text(encoding="utf-8"))) <= known
