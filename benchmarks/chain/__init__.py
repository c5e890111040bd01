"""The 96 kHz chain beside its rivals: run time, delay, error, drift."""
