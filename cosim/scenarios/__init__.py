"""Scenario files: what may stand in one, what it means for its FMUs, and the named ones."""
