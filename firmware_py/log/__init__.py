"""The log of a run: the ring of ticks, the recorder process and the files that it writes."""
