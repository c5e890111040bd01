"""The sensor board: accelerometer, load cell and period counts in, excitation and tendon out."""
