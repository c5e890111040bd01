"""A run that others watch: what it tells, and the page that shows it."""
