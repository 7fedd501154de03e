"""Kinds of cases: runs in software, runs of FMUs, diagnoses, trials of the rig."""
