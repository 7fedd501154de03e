"""Figures of the published study."""
