"""Objectives: how a candidate is scored against samples, by derivatives, roll-outs or a function of the user's."""
