"""The wired system: which FMU steps when, and which output goes to which input."""
