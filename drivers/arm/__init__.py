"""What any make of arm shares: axis, bounds, motion, streams, and the process that holds its link."""
