"""Software and hardware in the loop: emulated servos, timing, injected faults, reports."""
