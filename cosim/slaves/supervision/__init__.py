"""Supervision of FMU processes: their output, memory, children and end.

Its interface is `SupervisedProcess` and, in the process itself, `SupervisedChild`."""
