"""Pendulum and quadrotor: the physics, and the FMUs made from it. Standard library and pythonfmu only."""
