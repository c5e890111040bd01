"""What the bench does: one state machine per experiment."""
