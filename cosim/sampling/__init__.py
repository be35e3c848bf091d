"""Sampling: measurement of the plant, injection of sensor faults, filtering and screening of samples."""
