"""Tactile matrices (Weiss DSA 9210) behind their controller, a DSACON32-M on a serial line."""
