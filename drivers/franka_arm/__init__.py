"""A Franka arm through franky-control (libfranka)."""
