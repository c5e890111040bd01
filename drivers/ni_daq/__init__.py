"""Analog inputs of a National Instruments device."""
