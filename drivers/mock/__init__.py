"""The bench made of software: physics, drivers in the process, emulated devices on the wire, and their wiring."""
