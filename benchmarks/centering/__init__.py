"""The centering study (C3): 85 searches, twenty times over, the paper's algorithm and ours."""
