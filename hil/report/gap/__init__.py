"""Page of a gap before and after it was closed."""
