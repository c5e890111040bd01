"""A linear stage that speaks Zaber ASCII."""
