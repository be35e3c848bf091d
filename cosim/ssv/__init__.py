"""The SSV format: parameter values for SSP tools."""
