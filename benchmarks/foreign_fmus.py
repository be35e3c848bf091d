"""FMUs of the plants of benchmarks.foreign and of their controllers."""

from importlib import import_module
from pathlib import Path
from typing import Final

import fmu_models
from benchmarks.foreign_plants.plant import ForeignPlant
from fmu_models.build import assemble, sources

PLANTS: Final = (
    "ball", "servo", "boost", "bio", "ship", "generator", "heater", "arm", "cartpole", "crane",
    "maglev", "motor", "glucose", "cstr", "cylinder", "segway", "drone", "vehicle",
    "tanks", "pmsm", "suspension", "spacecraft",
)  # fmt: skip
_ENTRY: Final = '''"""Entry script of {name}.fmu."""

from benchmarks.foreign_plants.{module} import PLANT
from benchmarks.foreign_plants.fmu import {base} as Model


class {name}(Model):
    """{title}."""

    plant = PLANT
'''


def plant_named(name: str) -> ForeignPlant:
    """Return the declaration of a plant."""
    return import_module(f"benchmarks.foreign_plants.{name}").PLANT


def build(plant: ForeignPlant, folder: Path) -> None:
    """Build the FMUs of a plant and of its controller into the folder."""
    package = Path(__file__).parent / "foreign_plants"
    shipped = {f"benchmarks/{path}": text for path, text in sources(package).items()}
    shipped |= {"benchmarks/__init__.py": b"", **sources(Path(fmu_models.__path__[0]))}
    stem = plant.name.capitalize()
    for name, base, title in (
        (stem, "PlantFmu", plant.title),
        (f"{stem}Controller", "ControllerFmu", f"Controller of: {plant.title}"),
    ):
        script = f"{name.lower()}_fmu"
        entry = _ENTRY.format(name=name, module=plant.name, base=base, title=title)
        assemble(name, script, {**shipped, f"{script}.py": entry.encode()}, {}, folder)
