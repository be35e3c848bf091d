"""Pages that show runs in a browser: a report in one file, and a page that grows with the run."""
