"""Physics; knows no protocol."""
