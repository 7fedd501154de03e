"""Timing of a run: verdict, tick budget, processor accounts and reference jitter."""
