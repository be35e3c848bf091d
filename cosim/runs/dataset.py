"""A run as an xarray Dataset: its columns over time, with units and attributes."""

from typing import Any

from .quantities import units_of
from .result import Run


def to_dataset(run: Run) -> Any:
    """Return the series as an xarray Dataset, units and the run's figures as attributes. Raises ImportError."""
    try:
        import xarray as xr
    except ImportError as e:
        raise ImportError("to_xarray needs xarray: pip install 'fmu-retune[xarray]'") from e
    units = units_of(run)
    attributes = {name: {"units": units[name]} if name in units else {} for name in run.series}
    roles = {run.scenario.held_column(p): f"{p.name} in the controller" for p in run.scenario.estimation.parameters}
    roles |= {run.scenario.true_reference(p): f"true {p.name}" for p in run.scenario.estimation.parameters}
    roles |= {output: f"tracks {reference}" for output, reference in run.scenario.tracking.items()}
    for name, role in roles.items():
        attributes.setdefault(name, {})["long_name"] = role
    columns = {str(name): ("time", values, attributes[name]) for name, values in run.series.items() if name != "time"}
    return xr.Dataset(
        columns,
        {"time": ("time", run.time, {"units": "s", "long_name": "communication point"})},
        {
            "title": str(run.scenario.scenario.name), "estimator": run.estimator, "seed": run.seed,
            "status": run.status, "mean_squared_error": run.mse, "tracked": [str(o) for o in run.scenario.tracking],
        },
    )  # fmt: skip
