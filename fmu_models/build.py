"""Sources to FMUs, reproducibly: the same sources give the same bytes in any directory, process and order."""

import os
import re
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterable, Iterator, Mapping
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
        "FrictionPendulumControllerAdaptive": "friction_pendulum_controller_adaptive_fmu",
        "Pendulum": "pendulum_fmu",
        "PendulumController": "pendulum_controller_fmu",
        "PendulumControllerAdaptive": "pendulum_controller_adaptive_fmu",
        "PendulumReference": "pendulum_reference_fmu",
        "PendulumSine": "pendulum_sine_fmu",
        "Quadrotor": "quadrotor_fmu",
        "QuadrotorController": "quadrotor_controller_fmu",
        "QuadrotorControllerAdaptive": "quadrotor_controller_adaptive_fmu",
        "QuadrotorReference": "quadrotor_reference_fmu",
        "RigidBody": "rigid_body_fmu",
        "RigidBodyController": "rigid_body_controller_fmu",
        "RigidBodyControllerAdaptive": "rigid_body_controller_adaptive_fmu",
        "RigidBodyReference": "rigid_body_reference_fmu",
    }
)
NAMES = tuple(_SCRIPTS)
_EPOCH = (1980, 1, 1, 0, 0, 0)
_imports = threading.Lock()


def guid(name: str) -> str:
    """The GUID that `build(name)` gives: it depends on the name, the shipped sources and pythonfmu's version."""
    return _identity(name, _files(_script(name)))


def build(name: str, out_dir: Path | str) -> Path:
    """Build one FMU into `out_dir`, made if it is not there; returns the path of `<name>.fmu`.

    The file appears at once and whole, so builds may run at the same time. Raises ValueError for an unknown name.
    """
    script = _script(name)
    return assemble(name, script, _files(script), out_dir)


def assemble(name: str, script: str, files: Mapping[str, bytes], out_dir: Path | str) -> Path:
    """Build an FMU from its files, by their paths: the entry script, `<script>.py`, and all that it imports.

    A requirements.txt among them says what else it needs, for `python -m pythonfmu deploy -f FMU`.
    """
    out_dir = Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fmu_models_") as directory:
        stage = Path(directory)
        for path, text in files.items():
            (stage / "source" / path).parent.mkdir(parents=True, exist_ok=True)
            (stage / "source" / path).write_bytes(text)
        entry = stage / "source" / f"{script}.py"
        others = sorted(path for path in entry.parent.iterdir() if path != entry)
        with _imports_restored(script):
            raw = FmuBuilder.build_FMU(entry, dest=stage / "raw", project_files=others)
        target, temporary = out_dir / f"{name}.fmu", out_dir / f".{name}.{uuid4().hex}.tmp"
        try:
            _rewrite(raw, temporary, _identity(name, files), script, files)
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


def sources(package: Path) -> dict[str, bytes]:
    """The modules of a package by their paths in an FMU."""
    return {f"{package.name}/{path.name}": path.read_bytes() for path in sorted(package.glob("*.py"))}


def _files(script: str) -> dict[str, bytes]:
    return sources(PACKAGE) | {f"{script}.py": (PACKAGE / f"{script}.py").read_bytes()}


def _identity(name: str, files: Mapping[str, bytes]) -> str:
    digest = sha256(f"{name} {pythonfmu_version}\n".encode())
    for path, text in files.items():
        digest.update(f"{path} {len(text)}\n".encode() + text)
    return str(uuid5(NAMESPACE, digest.hexdigest()))


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


def _rewrite(raw: Path, target: Path, identity: str, script: str, files: Iterable[str]) -> None:
    """Copy an FMU with its GUID set, its entries sorted, and no trace of when and where it was built.

    Script and modules get names that no other FMU has: FMUs in one process share Python's modules, by name, and would
    look for a package in the folder of the one that came first, which may be gone or of another version.
    """
    suffix = f"_{identity[:8]}"
    tops = {path: re.match(r"\w+", path)[0] for path in files if path.endswith(".py")}
    own = {f"resources/{path}": f"resources/{top}{suffix}{path[len(top) :]}" for path, top in tops.items()}
    with zipfile.ZipFile(raw) as source, zipfile.ZipFile(target, "x", zipfile.ZIP_DEFLATED) as copy:
        for path in sorted(set(source.namelist()), key=lambda path: own.get(path, path)):
            content = source.read(path)
            if path == "modelDescription.xml":
                root = ElementTree.fromstring(content)
                root.set("guid", identity)
                content = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
            elif path == "resources/slavemodule.txt":
                content = f"{script}{suffix}".encode()
            elif path in own:
                content = _with_own_names(content, set(tops.values()), suffix)
            entry = zipfile.ZipInfo(own.get(path, path), _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, so that the permissions below count everywhere
            entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            copy.writestr(entry, content)


def _with_own_names(source: bytes, modules: Iterable[str], suffix: str) -> bytes:
    """A source that imports these modules under their names in the FMU, be it `from a.b import c`, `import a.b as c` or
    `import a`; no other way to import them is understood."""
    names = "|".join(sorted(modules)).encode()
    source = re.sub(rb"^(\s*)import (%b)(?=\s*(#|$))" % names, rb"\1import \2 as \2", source, flags=re.MULTILINE)
    own = rb"\1\2%b" % suffix.encode()
    return re.sub(rb"^(\s*(?:from|import) )(%b)\b" % names, own, source, flags=re.MULTILINE)
