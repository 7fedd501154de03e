"""Self-contained HTML pages of a build directory, a fault campaign, a closed gap, and plans.

A build: `build_inputs` reads its files, `build_page` assembles the sections: `arm` and
`loop_section`, `plant_section`, `fault_section`, `study_section`. A closed gap: `gap_page`. Plans:
`plans_page`. Parts of a page, colours and drawings come from `models.shared`.
"""
