"""Fuzzer of the FMU's calls, in C under sanitizers."""
