"""Inference: the bundle with its DI estimator, its tip predictor and its golden ticks."""
