"""Emulated servos: registers, packets, the line and the physics behind them."""
