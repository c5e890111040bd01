"""A bench made of software: physics, emulated devices on the wire, mock drivers in the process, and their wiring."""
