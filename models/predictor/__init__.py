"""Predictors of the tip: candidates, intervals, training, and their ONNX graphs."""
