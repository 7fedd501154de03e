"""Software of the robot PC: fixed-rate loop, estimator, predictor, safety and log."""

__version__ = "0.2.0"
