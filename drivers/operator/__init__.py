"""The person at the bench as a device: asked to do what the program cannot."""
