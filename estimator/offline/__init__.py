"""Estimation from a whole log: the fit, its honest standard deviations, and what the data do not determine."""
