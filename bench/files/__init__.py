"""Memory and time that files of 100 MB take from their readers."""
