"""What the bench is made of: one package per device, and what they share in core."""
