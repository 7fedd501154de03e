"""Do the tests notice when the code decides differently? `make mutate`.

A seeded sample of mutants, drawn for each subject of `subjects.py`, runs against the subject's
tests; the fraction killed may not fall below `fractions.json`.

Our own code, because neither mutmut 3 nor cosmic-ray, both well kept, draws a sample by subject
that stays the same while code moves: mutmut runs every mutant of a copied tree behind trampolines,
cosmic-ray starts Python with all libraries for each.
"""
