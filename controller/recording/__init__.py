"""Recorder, reader, run folder and rows: what stays of a run."""
