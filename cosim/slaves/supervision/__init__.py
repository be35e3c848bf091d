"""Supervision of FMU processes: what they print, hold, start and leave behind. Doors: `SupervisedProcess`, and in the
process itself `SupervisedChild`."""
