"""Parameters from recorded data."""
