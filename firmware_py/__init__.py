"""What runs on the robot PC: the fixed-rate loop, its estimator, predictor and safety."""

__version__ = "0.2.0"
