"""Software and hardware in the loop: emulated servos, line, timing verdict, faults, report."""
