"""Sources to FMUs, reproducibly: the same sources give the same bytes in any directory, process and order."""

import os
import re
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from uuid import uuid4, uuid5
from xml.etree import ElementTree

from pythonfmu import FmuBuilder
from pythonfmu import __version__ as pythonfmu_version

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


def guid(name: str) -> str:
    """The GUID that `build(name)` gives: it depends on the name, the shipped sources and pythonfmu's version."""
    _script(name)
    digest = sha256(f"{name} {pythonfmu_version}\n".encode())
    for path, text in _sources().items():
        digest.update(f"{path} {len(text)}\n".encode() + text)
    return str(uuid5(NAMESPACE, digest.hexdigest()))


def build(name: str, out_dir: Path | str) -> Path:
    """Build one FMU into `out_dir`, made if it is not there; returns the path of `<name>.fmu`.

    The file appears at once and whole, so builds may run at the same time. Raises ValueError for an unknown name.
    """
    script, identity, out_dir = _script(name), guid(name), Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fmu_models_") as directory:
        stage = Path(directory)
        package = stage / "source" / PACKAGE.name
        package.mkdir(parents=True)
        for path, text in _sources().items():
            (package / path).write_bytes(text)
        entry = stage / "source" / f"{script}.py"
        entry.write_bytes((package / f"{script}.py").read_bytes())
        with _imports_restored(script):
            raw = FmuBuilder.build_FMU(entry, dest=stage / "raw", project_files=[package])
        target, temporary = out_dir / f"{name}.fmu", out_dir / f".{name}.{uuid4().hex}.tmp"
        try:
            _rewrite(raw, temporary, identity, script)
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    return target


def build_all(out_dir: Path | str) -> dict[str, Path]:
    """Build all FMUs into `out_dir`; returns their paths by name."""
    return {name: build(name, out_dir) for name in NAMES}


def _script(name: str) -> str:
    if name not in _SCRIPTS:
        raise ValueError(f"name must be one of {', '.join(NAMES)}, got {name!r}.")
    return _SCRIPTS[name]


def _sources() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(PACKAGE.glob("*.py"))}


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


def _rewrite(raw: Path, target: Path, identity: str, script: str) -> None:
    """Copy an FMU with its GUID set, its entries sorted, and no trace of when and where it was built.

    Script and package get names that no other FMU has: FMUs in one process share Python's modules, by name, and would
    look for the package in the folder of the one that came first, which may be gone or of another version.
    """
    suffix = f"_{identity[:8]}"
    statement = re.compile(rf"^(from|import) {PACKAGE.name}\b".encode(), re.MULTILINE)
    names = {
        f"resources/{script}.py": f"resources/{script}{suffix}.py",
        **{f"resources/{PACKAGE.name}/{path}": f"resources/{PACKAGE.name}{suffix}/{path}" for path in _sources()},
    }
    with zipfile.ZipFile(raw) as source, zipfile.ZipFile(target, "x", zipfile.ZIP_DEFLATED) as copy:
        for path in sorted(set(source.namelist()), key=lambda path: names.get(path, path)):
            content = source.read(path)
            if path == "modelDescription.xml":
                root = ElementTree.fromstring(content)
                root.set("guid", identity)
                content = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
            elif path == "resources/slavemodule.txt":
                content = f"{script}{suffix}".encode()
            elif path in names:
                content = statement.sub(rf"\1 {PACKAGE.name}{suffix}".encode(), content)
            entry = zipfile.ZipInfo(names.get(path, path), _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, so that the permissions below count everywhere
            entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            copy.writestr(entry, content)
