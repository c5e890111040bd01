"""What the bench is made of: one package per device, and a bench made of software."""
