"""Learning: polynomial predictors, the lagged DI regressor and their export to ONNX."""
