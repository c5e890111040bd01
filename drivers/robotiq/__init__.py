"""A Robotiq gripper through the socket of its URCap."""
