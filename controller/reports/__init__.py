"""Reports: tables, figures and one HTML page, from recordings alone."""
