"""Commands of `hil`, one module each (see `firmware_py.core.console`)."""
