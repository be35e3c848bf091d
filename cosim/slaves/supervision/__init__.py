"""Supervision of FMU processes: what they print, hold, fork and leave behind."""
