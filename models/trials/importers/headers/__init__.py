"""Headers of text exports of motion capture that precede their columns."""
