"""Common parts of all plants: integration, rotations, the kinds of FMU and their descriptions."""
