"""What connects physics and devices: the emulator's process and its lines."""
