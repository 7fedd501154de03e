"""The robot PC: clock, timing, checks of the doctor, service, stop signals."""
