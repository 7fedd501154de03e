"""Software of the robot PC: fixed-rate loop, estimator, predictor, safety and log."""

__version__ = "0.3.0"
