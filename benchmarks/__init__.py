"""Measurements: run time against error, cost of the loop, latency of the stop."""
