"""Do the tests notice when the code decides differently? `make mutate`.

A seeded sample of mutants of each subject of `subjects.py`, Python or C, runs against the tests of
the subject; `fractions.json` holds how many were killed. mutmut 3 and cosmic-ray draw no sample by
subject that stays the same while code moves, and neither mutates C.
"""
