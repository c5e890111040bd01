"""The swarm: short campaigns in virtual time in which things go wrong as a seed draws them, and what must hold then."""
