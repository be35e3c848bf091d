"""Co-simulation of FMUs whose controller is re-tuned while it runs."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .errors import CosimError as CosimError
    from .errors import FolderError as FolderError
    from .errors import ModelDescriptionError as ModelDescriptionError
    from .errors import ScenarioError as ScenarioError
    from .errors import SlaveError as SlaveError
    from .errors import SspError as SspError
    from .errors import WiringError as WiringError
    from .runs.result import Run as Run
    from .runs.simulation import resume as resume
    from .runs.simulation import run as run
    from .scenarios.scenario import Scenario as Scenario
    from .slaves.slave import Slave as Slave
    from .slaves.slave import open_slave as open_slave
    from .ssp.load import load_scenario as load_scenario
    from .ssp.package import System as System

_HOMES = {
    "CosimError": "errors",
    "FolderError": "errors",
    "ModelDescriptionError": "errors",
    "ScenarioError": "errors",
    "SlaveError": "errors",
    "SspError": "errors",
    "WiringError": "errors",
    "Run": "runs.result",
    "resume": "runs.simulation",
    "run": "runs.simulation",
    "Scenario": "scenarios.scenario",
    "Slave": "slaves.slave",
    "System": "ssp.package",
    "load_scenario": "ssp.load",
    "open_slave": "slaves.slave",
}


def __getattr__(name: str) -> object:
    # Loaded on first use: an FMU's process imports cosim.slaves.child and needs neither GPy nor pydantic.
    if name not in _HOMES:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
