"""The fingers' sound: two channels of 24 bits at 96 kHz in, the drive of their transducers out."""
