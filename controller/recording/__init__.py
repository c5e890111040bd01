"""Recorder, reader, run folder and ledger: what stays of a run."""
