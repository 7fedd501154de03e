"""Search for missing effects: candidates, evidence, consistency and look-alikes."""
