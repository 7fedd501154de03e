"""Headers above the columns in text exports of motion capture."""
