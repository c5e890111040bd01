"""Pre-touch and contact at the paper's true-negative rates, on simulated fingers."""
