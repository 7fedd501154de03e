"""Commands of the FMI export, one module each (see `firmware_py.core.console`)."""
