"""Runs: how they are simulated, recorded in folders, resumed and reported."""
