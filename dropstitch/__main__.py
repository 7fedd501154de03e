"""Command line of the package, `python -m dropstitch`: the same as the command `dropstitch`."""

import sys

from firmware_py.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
