"""A Universal Robots arm through its controller, with the ur_rtde client in a process of its own."""
