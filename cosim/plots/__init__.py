"""Figures of runs, and elements of the paper's figures."""
