"""Measurements: cost of the loop, latency of the stop, detectors beside rivals."""
