"""Detectors: sample blocks in, events out. Pure: no clock, no I/O, no thread, no truth."""
