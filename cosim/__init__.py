"""Co-simulation of FMUs whose controller is re-tuned while it runs."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .campaigns.compare import compare as compare
    from .campaigns.comparison import Comparison as Comparison
    from .errors import CosimError as CosimError
    from .errors import FolderError as FolderError
    from .errors import ModelDescriptionError as ModelDescriptionError
    from .errors import ScenarioError as ScenarioError
    from .errors import SlaveError as SlaveError
    from .errors import SspError as SspError
    from .errors import UnfinishedError as UnfinishedError
    from .errors import WiringError as WiringError
    from .offline.estimate import Estimation as Estimation
    from .offline.from_python import estimate as estimate
    from .offline.online import Online as Online
    from .offline.online_from_python import estimate_online as estimate_online
    from .offline.request import EstimateError as EstimateError
    from .plots.beliefs import plot_belief as plot_belief
    from .plots.beliefs import plot_surrogate as plot_surrogate
    from .runs.result import Run as Run
    from .runs.result import read_run as read_run
    from .runs.simulation import resume as resume
    from .runs.simulation import run as run
    from .scenarios.scenario import Scenario as Scenario
    from .slaves.slave import Slave as Slave
    from .slaves.slave import open_slave as open_slave
    from .ssp.load import load_scenario as load_scenario
    from .ssp.system import System as System

__version__ = "0.1.0"

_MODULES = {
    "Comparison": "campaigns.comparison",
    "CosimError": "errors",
    "EstimateError": "offline.request",
    "Estimation": "offline.estimate",
    "FolderError": "errors",
    "ModelDescriptionError": "errors",
    "Online": "offline.online",
    "Run": "runs.result",
    "Scenario": "scenarios.scenario",
    "ScenarioError": "errors",
    "Slave": "slaves.slave",
    "SlaveError": "errors",
    "SspError": "errors",
    "System": "ssp.system",
    "UnfinishedError": "errors",
    "WiringError": "errors",
    "compare": "campaigns.compare",
    "estimate": "offline.from_python",
    "estimate_online": "offline.online_from_python",
    "load_scenario": "ssp.load",
    "open_slave": "slaves.slave",
    "plot_belief": "plots.beliefs",
    "plot_surrogate": "plots.beliefs",
    "read_run": "runs.result",
    "resume": "runs.simulation",
    "run": "runs.simulation",
}
"""The module of each public name."""


def __getattr__(name: str) -> object:
    # Loaded on first use: an FMU's process imports cosim.slaves.child and needs neither GPy nor pydantic.
    if name not in _MODULES:
        raise AttributeError(f"module 'cosim' has no attribute '{name}'")
    from .shadowing import check_packages

    check_packages()
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)


def __dir__() -> list[str]:
    return [*_MODULES, "__version__"]
