"""Decision on a search: tests of its effects, verdict, probabilities."""
