"""Any board that prints a line of numbers for each sample."""
