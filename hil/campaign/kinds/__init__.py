"""Kinds of cases: runs in software, FMUs, diagnoses, trials of the rig."""
