"""The aura's two levels: what the envelope saves against the carrier, and what it leaves out."""
