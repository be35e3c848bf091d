"""Worked examples: `python -m examples NAME` builds the FMUs of one and carries out its commands."""
