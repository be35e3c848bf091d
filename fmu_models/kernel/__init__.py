"""The parts that every plant is made of: integration, rotations, the kinds of FMU and their descriptions."""
