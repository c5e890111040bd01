"""Contact from the finger's resonance: the paper's detector, its rivals and ours on simulated approaches."""
