"""Offline: trials, the rig, the plant, learning, the gap workflow, export."""
