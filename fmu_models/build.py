"""Sources to FMUs, reproducibly: the same sources give the same bytes in any directory, process and order."""

import os
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Literal
from uuid import uuid4, uuid5
from xml.etree import ElementTree

import pythonfmu
from pythonfmu import FmuBuilder
from pythonfmu import __version__ as pythonfmu_version
from pythonfmu3 import FmuBuilder as Fmi3Builder
from pythonfmu3 import __version__ as pythonfmu3_version

from . import documentation
from .slave import NAMESPACE

PACKAGE = Path(__file__).parent
_SCRIPTS = MappingProxyType(
    {
        "FrictionPendulum": "friction_pendulum_fmu",
        "FrictionPendulumController": "friction_pendulum_controller_fmu",
        "Pendulum": "pendulum_fmu",
        "PendulumController": "pendulum_controller_fmu",
        "PendulumReference": "pendulum_reference_fmu",
        "PendulumSine": "pendulum_sine_fmu",
        "Quadrotor": "quadrotor_fmu",
        "QuadrotorController": "quadrotor_controller_fmu",
        "QuadrotorReference": "quadrotor_reference_fmu",
        "RigidBody": "rigid_body_fmu",
        "RigidBodyController": "rigid_body_controller_fmu",
        "RigidBodyReference": "rigid_body_reference_fmu",
    }
)
NAMES = tuple(_SCRIPTS)
_EPOCH = (1980, 1, 1, 0, 0, 0)
_imports = threading.Lock()


Interface = Literal["CoSimulation", "ModelExchange"]
PLANTS = ("FrictionPendulum", "Pendulum", "Quadrotor", "RigidBody")
"""What there is for model exchange, in FMI 3.0: the others have no states."""
_ENTRY = """\"\"\"Entry script of {name}.fmu, FMI 3.0.\"\"\"

from pythonfmu3 import Fmi3SlaveBase

from fmu_models.fmi3 import Fmi3{interface}
from fmu_models.{script} import {name} as Model


class {name}(Fmi3{interface}, Fmi3SlaveBase):
    __doc__ = Model.__doc__
    model = Model
"""


def guid(name: str, fmi: int = 2, interface: Interface = "CoSimulation") -> str:
    """The GUID that `build` gives: it depends on what is built, the shipped files and the libraries' versions."""
    _script(name, fmi, interface)
    kind = "" if fmi == 2 else f" {interface} {pythonfmu3_version}"
    digest = sha256(f"{name} {pythonfmu_version}{kind}\n".encode())
    for path, text in _sources().items():
        digest.update(f"{path} {len(text)}\n".encode() + text)
    return str(uuid5(NAMESPACE, digest.hexdigest()))


def build(name: str, out_dir: Path | str, fmi: int = 2, interface: Interface = "CoSimulation") -> Path:
    """Build one FMU, FMI 2.0 or 3.0, into `out_dir`, made if it is not there; returns the path of `<name>.fmu`.

    The file appears at once and whole, so builds may run at the same time. Raises ValueError for an unknown name, and
    for model exchange of what is no plant, or in FMI 2.0.
    """
    script, identity, out_dir = _script(name, fmi, interface), guid(name, fmi, interface), Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fmu_models_") as directory:
        stage = Path(directory)
        package = stage / "source" / PACKAGE.name
        package.mkdir(parents=True)
        for path, text in _sources().items():
            (package / path).write_bytes(text)
        raw = (_build_fmi2 if fmi == 2 else _build_fmi3)(name, script, interface, package, stage / "raw")
        target, temporary = out_dir / f"{name}.fmu", out_dir / f".{name}.{uuid4().hex}.tmp"
        model = getattr(import_module(f"{__package__}.{script}"), name)
        variables = model.exchange_table() if interface == "ModelExchange" else model.variables
        libraries = ("pythonfmu",) if fmi == 2 else ("pythonfmu", "pythonfmu3")
        try:
            _rewrite(raw, temporary, identity, documentation.files(name, model.__doc__, variables, fmi, libraries))
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    return target


def build_all(out_dir: Path | str, fmi: int = 2, interface: Interface = "CoSimulation") -> dict[str, Path]:
    """Build all FMUs of that kind into `out_dir`; returns their paths by name."""
    names = PLANTS if interface == "ModelExchange" else NAMES
    return {name: build(name, out_dir, fmi, interface) for name in names}


def _build_fmi2(name: str, script: str, interface: Interface, package: Path, out_dir: Path) -> Path:
    entry = package.parent / f"{script}.py"
    entry.write_bytes((package / f"{script}.py").read_bytes())
    with _imports_restored(script):
        return FmuBuilder.build_FMU(entry, dest=out_dir, project_files=[package])


def _build_fmi3(name: str, script: str, interface: Interface, package: Path, out_dir: Path) -> Path:
    """With the Python part of pythonfmu beside the package, for the Slave inside."""
    library = package.parent / "pythonfmu"
    library.mkdir()
    for path in Path(pythonfmu.__file__).parent.glob("*.py"):
        (library / path.name).write_bytes(path.read_bytes())
    entry = package.parent / f"{script}3_{interface.lower()}.py"  # no module of another FMU has this name
    entry.write_text(_ENTRY.format(name=name, script=script, interface=interface))
    with _imports_restored(entry.stem):
        return Fmi3Builder.build_FMU(entry, dest=out_dir, project_files=[package, library])


def _script(name: str, fmi: int = 2, interface: Interface = "CoSimulation") -> str:
    if name not in _SCRIPTS:
        raise ValueError(f"name must be one of {', '.join(NAMES)}, got {name!r}.")
    if fmi not in (2, 3):
        raise ValueError(f"fmi must be 2 or 3, got {fmi!r}.")
    if interface == "ModelExchange" and (name not in PLANTS or fmi != 3):
        raise ValueError(f"model exchange is for {', '.join(PLANTS)} in FMI 3.0, got {name} in FMI {fmi}.0.")
    return _SCRIPTS[name]


def _sources() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted([*PACKAGE.glob("*.py"), documentation.LICENSE])}


@contextmanager
def _imports_restored(module: str) -> Iterator[None]:
    """sys.path and sys.modules as they were: the builder imports its script by stem, and leaves both changed."""
    with _imports:
        path, loaded = list(sys.path), sys.modules.pop(module, None)
        try:
            yield
        finally:
            sys.path[:] = path
            sys.modules.pop(module, None)
            if loaded is not None:
                sys.modules[module] = loaded


def _rewrite(raw: Path, target: Path, identity: str, extra: Mapping[str, bytes]) -> None:
    """Copy an FMU with its GUID set and files added, its entries sorted, and no trace of when and where."""
    with zipfile.ZipFile(raw) as source, zipfile.ZipFile(target, "x", zipfile.ZIP_DEFLATED) as copy:
        # Nobody builds this FMU from C++: FMI 3.0 asks for a build description beside sources.
        kept = {path for path in source.namelist() if not path.startswith("sources/")}
        for path in sorted(kept | set(extra)):
            content = extra[path] if path in extra else source.read(path)
            if path == "modelDescription.xml":
                content = _identified(content, identity)
            entry = zipfile.ZipInfo(path, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, so that the permissions below count everywhere
            entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            copy.writestr(entry, content)


def _identified(description: bytes, identity: str) -> bytes:
    root = ElementTree.fromstring(description)
    root.set("guid" if root.get("fmiVersion") == "2.0" else "instantiationToken", identity)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
