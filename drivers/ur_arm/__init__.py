"""A Universal Robots arm through its controller: ur_rtde, and the dashboard."""
