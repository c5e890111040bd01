"""Drivers of simulated devices, in the process and in virtual time."""
