"""Runs: simulated, recorded in folders, resumed and reported."""
