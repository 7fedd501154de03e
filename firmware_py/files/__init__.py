"""Files from outside: bounded reading, and work in a child process with limits."""
