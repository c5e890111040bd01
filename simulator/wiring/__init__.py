"""What connects physics and devices: benches, the emulator's process and its lines."""
