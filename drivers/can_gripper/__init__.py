"""A parallel gripper on a CAN bus: Source Robotics SSG-48."""
