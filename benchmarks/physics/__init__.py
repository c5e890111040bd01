"""Run time against error of the finger's physics: our tiers, their rivals, and references of another kind."""
