"""The bench made of software: plants, mock drivers in the process, emulated devices on the wire."""
