"""System Structure and Parameterization (SSP), versions 1.0 and 2.0: packages of FMUs that are joined, in and out."""
