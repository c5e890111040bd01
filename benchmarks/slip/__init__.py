"""Slip detectors at equal false alarms, on simulated sensors."""
