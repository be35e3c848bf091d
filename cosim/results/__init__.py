"""Run folders: written, read, reported, compared and replayed."""
