"""A run that others watch: what it publishes, and the page that shows it."""
