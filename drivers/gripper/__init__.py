"""What any gripper shares: what its states say, what became of a command, which commands it takes."""
