"""The re-tuning loop as an FMU for other masters."""
