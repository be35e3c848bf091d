"""Builder of estimator FMUs: the slave of `slave.py` with a scenario's settings, and all that it imports."""

import ast
import re
from collections import Counter
from collections.abc import Collection, Mapping
from modulefinder import ModuleFinder
from pathlib import Path
from pprint import pformat
from typing import Any

import estimator
import fmu_models
from fmu_models import documentation
from fmu_models.build import assemble, sources

from ..errors import ScenarioError
from ..scenarios.scenario import Scenario
from ..user_code import places_of
from .settings import estimator_settings
from .slave import references, variable_table
from .theory import ICON, THEORY

_SHIPPED = (
    "estimator_fmu/__init__.py",
    "estimator_fmu/loop.py",
    "estimator_fmu/slave.py",
    "names.py",
    "scenarios/__init__.py",
    "scenarios/formula.py",
    "scenarios/tuning_rule.py",
)
"""The modules of cosim that an estimator FMU imports: they need no more than `estimator` does."""
_INIT = b'"""What an estimator FMU has of cosim."""\n'
_OURS = ("cosim", "estimator", "fmu_models")


def build_estimator(scenario: Scenario, out_dir: Path, method: str = "target") -> Path:
    """Build the scenario's estimator as an FMU in `out_dir`; return its path, QuadrotorEstimator.fmu for `quadrotor`.

    The same scenario and sources give the same bytes.
    Raises ScenarioError, ModelDescriptionError or WiringError for what `run` refuses, and for what cannot be shipped.
    """
    settings = estimator_settings(scenario, method)
    words = re.split(r"[-_]", scenario.scenario.name)
    name = "".join(word[:1].upper() + word[1:] for word in words) + "Estimator"
    if not name.isidentifier():
        raise ScenarioError(f"scenario.name '{scenario.scenario.name}' must begin with a letter to name an FMU.")
    repeated = [n for n, count in Counter(v.name for v in variable_table(settings)).items() if count > 1]
    if repeated:
        raise ScenarioError(f"{name}.fmu would have two variables '{repeated[0]}': rename one in the plant.")
    script = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower() + "_fmu"
    own = Path(__file__).parents[1]
    files = {
        "cosim/__init__.py": _INIT,
        **{f"cosim/{module}": (own / module).read_bytes() for module in _SHIPPED},
        **sources(Path(estimator.__path__[0])),
        **sources(Path(fmu_models.__path__[0])),
        **_user_sources(settings, scenario),
    }
    tops = sorted({path.partition("/")[0].removesuffix(".py") for path in files})
    files["requirements.txt"] = "".join(f"{package}\n" for package in settings["requires"]).encode()
    files[f"{script}.py"] = _entry(name, scenario, settings | {"ships": tops}).encode()
    try:
        summary = f"Estimator of the scenario {scenario.scenario.name}: {method}"
        page = documentation.Page(name, summary, THEORY, variable_table(settings), ICON.read_bytes())
        return assemble(name, script, files, documentation.files(page, 2, ("pythonfmu",)), out_dir)
    except RuntimeError as e:  # the FMU is instantiated for its description
        raise ScenarioError(f"{e}.") from e


def _user_sources(settings: Mapping[str, Any], scenario: Scenario) -> dict[str, bytes]:
    """Return the user's modules with the model and what it imports, as `run` finds them. Raises ScenarioError."""
    files: dict[str, bytes] = {}
    for reference in references(settings):
        module = reference.partition(":")[0]
        if module.partition(".")[0] in _OURS:
            continue
        finder = ModuleFinder(path=places_of(reference, scenario.folder, scenario.origin), excludes=list(_OURS))
        try:
            finder.import_hook(module)
        except ImportError as e:
            raise ScenarioError(
                f"estimation.model: '{module}' must be a Python file beside the scenario to be shipped in an FMU: {e}."
            ) from e
        modules: dict[str, Any] = dict(finder.modules)
        for name, found in sorted(modules.items()):
            path = Path(found.__file__ or "")
            if path.suffix != ".py":
                raise ScenarioError(f"estimation.model: {path or name} is no Python source and cannot be shipped.")
            target = name.replace(".", "/")
            files[f"{target}/__init__.py" if found.__path__ else f"{target}.py"] = path.read_bytes()
    for path, text in files.items():
        _check_imports(path, text, {name.partition("/")[0].removesuffix(".py") for name in files} | set(_OURS))
    return files


def _check_imports(path: str, source: bytes, shipped: Collection[str]) -> None:
    """Raise ScenarioError for a form of import that `build` cannot adapt to the modules' new names in the FMU."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import) and any(alias.name.partition(".")[0] in shipped for alias in node.names):
            (first, *others) = node.names
            if others or ("." in first.name and not first.asname):
                text = ast.unparse(node)
                raise ScenarioError(f"{path}: '{text}' cannot be shipped in an FMU; write 'from ... import ...'.")


def _entry(name: str, scenario: Scenario, settings: Mapping[str, Any]) -> str:
    names = ", ".join(p["name"] for p in settings["parameters"])
    literal = pformat(settings, width=110, sort_dicts=False).replace("\n", "\n    ")
    infinite = "from math import inf\n\n" if re.search(r"\binf\b", literal) else ""
    return f'''"""Entry script of {name}.fmu."""

{infinite}from cosim.estimator_fmu.slave import EstimatorSlave


class {name}(EstimatorSlave):
    """Estimates {names} of the plant of scenario {scenario.scenario.name} by the method {settings["method"]}."""

    settings = {literal}
'''
