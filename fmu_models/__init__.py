"""Plants with their controllers: the physics, and the FMUs made from it. Standard library and pythonfmu only.

A plant is a folder; whatever has these files is built, documented and tested:
- `equations.py`, the physics as functions of tuples, and `__init__.py`, which hands them on;
- `plant.py`, `controller.py`, `reference.py`: a class for each FMU, made from a table of variables and a function;
- `plant.png`, `controller.png`, `reference.png`: their icons;
- `theory.py`, the equations for the documentation in the FMUs, and `README.md`, for the reader of the folder;
- `reference.csv`, a trajectory of an independent integration.

`kernel` is their common code, and `build` makes the files. `tests/fmu_models/reference_data.py` writes `reference.csv`.
"""
