"""Where FMUs run: processes, how they are placed, and what is sent to and fro."""
