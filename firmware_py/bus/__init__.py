"""The servo bus: registers, packets, deadlines and the official SDK behind one interface."""
