"""Numerics of the signal chain, pure: streams in, streams out."""
