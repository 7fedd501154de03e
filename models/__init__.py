"""Offline: trials, the virtual laboratory, the plant, learning, export."""
