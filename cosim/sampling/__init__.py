"""Sampling: what is measured of the plant, what sensor faults make of it, and which samples are screened out."""
