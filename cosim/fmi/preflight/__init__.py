"""Checks of an FMU before any of its code runs: the archive, its XML, what it declares, its library."""
