"""The person at the bench as a device: what the program cannot do, it asks for in words."""
