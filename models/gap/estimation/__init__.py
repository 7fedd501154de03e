"""Estimation against the noise floor: Gauss-Newton, model discrepancy and nuisance bias."""
