"""Self-contained HTML pages of a build directory, a fault campaign, a closed gap, and plans.

A build: `build_inputs` reads its files, `build_page` assembles a section for each kind of them,
`study_figures`, `loop_section` and `fault_section` draw what is in the larger ones. A closed gap:
`gap_results` and `gap_page`. Plans: `plans_page`. Parts of a page, colours and drawings come from
`models.shared`.
"""
