"""Do the tests notice when the code decides differently? `make mutate`.

A seeded sample of mutants, drawn for each subject of `subjects.py`, runs against the subject's
tests; the fraction killed may not fall below `fractions.json`.

Our own 400 lines, because mutmut 3 and cosmic-ray, both alive and well kept, have neither a sample
by subject that stays the same while code moves, nor a fraction by subject: mutmut runs all mutants
in a copy of the tree behind trampolines, cosmic-ray starts Python and its libraries for each one.
"""
