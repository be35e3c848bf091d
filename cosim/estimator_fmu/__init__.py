"""The loop as an FMU for other masters."""
