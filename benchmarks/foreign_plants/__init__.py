"""Plants that no scenario of the package has, each with a controller that is computed from its parameters.

A module has a plant's equations, its controller's law, its reference and PLANT, which declares them. Standard library
only, for the FMUs ship these modules.
"""
