"""Emulated devices: wire bytes on a plant."""
