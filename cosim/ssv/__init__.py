"""The SSV format: parameter values for other tools, and the XML that all SSP formats share."""
