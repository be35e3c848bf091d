"""Estimation of parameters from recorded data."""
