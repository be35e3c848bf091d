"""Scenario files: their schema, formulas and changes over time, and the named ones."""
