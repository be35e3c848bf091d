"""Bayesian optimisation: surrogates of residuals, acquisition functions, and the searches with them."""
