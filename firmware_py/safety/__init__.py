"""The safety supervisor: its states, its limits and the goals that it lets through."""
