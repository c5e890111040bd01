"""Physics, and what it has to do with a tool; knows no protocol."""
