"""The commands of this room, one module each (see firmware_py.core.console)."""
