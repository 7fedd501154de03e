"""Decision on a search: tests of what was found, verdict, probabilities."""
