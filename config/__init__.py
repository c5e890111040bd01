"""What the bench is and what to do: profiles, trials, and the table from names to classes."""
