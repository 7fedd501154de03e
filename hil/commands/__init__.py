"""Commands of this room, one module each (see firmware_py.console)."""
