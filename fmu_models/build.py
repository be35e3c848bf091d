"""Reproducible build of FMUs from sources: the same sources give the same bytes in any directory, process and order."""

import os
import re
import sys
import tempfile
import threading
import zipfile
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import replace
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Literal
from uuid import uuid4, uuid5
from xml.etree import ElementTree

import pythonfmu
from pythonfmu import FmuBuilder
from pythonfmu import __version__ as pythonfmu_version
from pythonfmu3 import FmuBuilder as Fmi3Builder
from pythonfmu3 import __version__ as pythonfmu3_version

from . import documentation
from .kernel.blocks import Adaptive, PlantSlave
from .kernel.description import VariableRow
from .kernel.slave import NAMESPACE, Slave
from .kernel.theory import ADAPTIVE, Theory

PACKAGE = Path(__file__).parent
MODULES = ("plant", "controller", "reference")
"""The modules of a plant's folder that hold FMUs."""


def _find_models() -> Mapping[str, type[Slave]]:
    """Return the classes that the modules of the plants' folders define, by name."""
    paths = [path for path in sorted(PACKAGE.glob("*/*.py")) if path.stem in MODULES]
    modules = [import_module(f"{__package__}.{path.parent.name}.{path.stem}") for path in paths]
    defined = {
        name: value for module in modules for name, value in vars(module).items() if _is_defined_in(module, value)
    }
    return MappingProxyType(dict(sorted(defined.items())))


def _is_defined_in(module: ModuleType, value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Slave) and value.__module__ == module.__name__


MODELS = _find_models()
"""The classes of the FMUs that come with the package, by name: all that there are in the plants' folders."""
NAMES = tuple(MODELS)
PLANTS = tuple(name for name, model in MODELS.items() if issubclass(model, PlantSlave))
"""Names of the models for model exchange, in FMI 3.0: the others have no states."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
_imports = threading.Lock()

Interface = Literal["CoSimulation", "ModelExchange"]
_ENTRY = """\"\"\"Entry script of {name}.fmu.\"\"\"

from {module} import {name} as Model


class {name}(Model):
    __doc__ = Model.__doc__
"""
_ENTRY_3 = """\"\"\"Entry script of {name}.fmu, FMI 3.0.\"\"\"

from pythonfmu3 import Fmi3SlaveBase

from fmu_models.kernel.fmi3 import Fmi3{interface}
from {module} import {name} as Model


class {name}(Fmi3{interface}, Fmi3SlaveBase):
    __doc__ = Model.__doc__
    model = Model
"""


def guid(name: str, fmi: int = 2, interface: Interface = "CoSimulation") -> str:
    """Return the GUID that `build` gives: it depends on the model, its files and the libraries' versions."""
    return _identity(name, fmi, _files(name, fmi, interface)[1])


def build(name: str, out_dir: Path | str, fmi: int = 2, interface: Interface = "CoSimulation") -> Path:
    """Build one FMU, FMI 2.0 or 3.0, into `out_dir`, made if it is not there; return the path of `<name>.fmu`.

    The file appears at once and whole, so builds may run at the same time. Raises ValueError for an unknown name, and
    for model exchange of what is no plant, or in FMI 2.0.
    """
    script, files = _files(name, fmi, interface)
    model = MODELS[name]
    page = documentation.Page(
        name=name,
        summary=model.__doc__ or "",
        theory=_theory(model),
        variables=_variables(model, interface),
        icon=_icon(model),
    )
    libraries = ("pythonfmu",) if fmi == 2 else ("pythonfmu", "pythonfmu3")
    return assemble(name, script, files, documentation.files(page, fmi, libraries), out_dir, fmi)


def assemble(
    name: str, script: str, files: Mapping[str, bytes], extra: Mapping[str, bytes], out_dir: Path | str, fmi: int = 2
) -> Path:
    """Build an FMU from its files, by their paths: the entry script, `<script>.py`, and all that it imports.

    extra: files beside the resources, by their paths in the FMU; they follow from the others, and the GUID is without.
    A requirements.txt among them lists the other packages it needs, for `python -m pythonfmu deploy -f FMU`.
    """
    out_dir = Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=out_dir.resolve()) as directory:
        stage = Path(directory)
        for path, text in files.items():
            (stage / "source" / path).parent.mkdir(parents=True, exist_ok=True)
            (stage / "source" / path).write_bytes(text)
        entry = stage / "source" / f"{script}.py"
        others = sorted(path for path in entry.parent.iterdir() if path != entry)
        with _imports_restored(script):
            raw = (FmuBuilder if fmi == 2 else Fmi3Builder).build_FMU(entry, dest=stage / "raw", project_files=others)
        target, temporary = out_dir / f"{name}.fmu", out_dir / f".{name}.{uuid4().hex}.tmp"
        try:
            _rewrite(raw, temporary, _identity(name, fmi, files), script, files, extra)
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    return target


def build_all(out_dir: Path | str, fmi: int = 2, interface: Interface = "CoSimulation") -> dict[str, Path]:
    """Build all FMUs of that kind into `out_dir`; return their paths by name."""
    names = PLANTS if interface == "ModelExchange" else NAMES
    return {name: build(name, out_dir, fmi, interface) for name in names}


def sources(package: Path) -> dict[str, bytes]:
    """Return the modules of a package, those in its folders too, by their paths in an FMU."""
    return {path.relative_to(package.parent).as_posix(): path.read_bytes() for path in sorted(package.rglob("*.py"))}


def _files(name: str, fmi: int, interface: Interface) -> tuple[str, dict[str, bytes]]:
    """Return the entry script's name, and its source with all that it imports, by their paths."""
    if name not in MODELS:
        raise ValueError(f"name must be one of {', '.join(NAMES)}, got {name!r}.")
    if fmi not in (2, 3):
        raise ValueError(f"fmi must be 2 or 3, got {fmi!r}.")
    if interface == "ModelExchange" and (name not in PLANTS or fmi != 3):
        raise ValueError(f"model exchange is for {', '.join(PLANTS)} in FMI 3.0, got {name} in FMI {fmi}.0.")
    stem = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower() + "_fmu"
    values = {"name": name, "module": MODELS[name].__module__, "interface": interface}
    own = _sources(MODELS[name])
    if fmi == 2:
        return stem, own | {f"{stem}.py": _ENTRY.format(**values).encode()}
    script = f"{stem}3_{interface.lower()}"  # the Slave inside needs the Python part of pythonfmu too
    libraries = sources(Path(pythonfmu.__file__).parent)
    return script, own | libraries | {f"{script}.py": _ENTRY_3.format(**values).encode()}


def _sources(model: type[Slave]) -> dict[str, bytes]:
    """Return the modules that a model needs: of its plant's folder and the kernel, but of no other plant."""
    folders = (model.__module__.split(".")[1], "kernel")
    there = [f"{PACKAGE.name}/__init__.py", *(f"{PACKAGE.name}/{folder}/" for folder in folders)]
    return {path: text for path, text in sources(PACKAGE).items() if path.startswith(tuple(there))}


def _variables(model: type[Slave], interface: Interface) -> tuple[VariableRow, ...]:
    return model.exchange_table() if interface == "ModelExchange" and issubclass(model, PlantSlave) else model.variables


def _theory(model: type[Slave]) -> Theory:
    """Return the text of the model, or of what it is derived from, by its folder's module `theory`."""
    texts = import_module(f"{model.__module__.rpartition('.')[0]}.theory").THEORY
    theory = next(texts[base.__name__] for base in model.__mro__ if base.__name__ in texts)
    return replace(theory, notes=theory.notes + ADAPTIVE) if issubclass(model, Adaptive) else theory


def _icon(model: type[Slave]) -> bytes | None:
    """Return the picture beside the module that defines the model, `controller.png` of `controller.py`, if any."""
    path = PACKAGE.parent.joinpath(*model.__module__.split(".")).with_suffix(".png")
    return path.read_bytes() if path.is_file() else None


def _identity(name: str, fmi: int, files: Mapping[str, bytes]) -> str:
    libraries = pythonfmu_version if fmi == 2 else f"{pythonfmu_version} {pythonfmu3_version}"
    digest = sha256(f"{name} {libraries}\n".encode())
    for path, text in files.items():
        digest.update(f"{path} {len(text)}\n".encode() + text)
    return str(uuid5(NAMESPACE, digest.hexdigest()))


@contextmanager
def _imports_restored(module: str) -> Generator[None]:
    """Restore sys.path and sys.modules: the builder imports its script by stem, and leaves both changed."""
    with _imports:
        path, loaded = list(sys.path), sys.modules.pop(module, None)
        try:
            yield
        finally:
            sys.path[:] = path
            sys.modules.pop(module, None)
            if loaded is not None:
                sys.modules[module] = loaded


def _rewrite(
    raw: Path, target: Path, identity: str, script: str, files: Iterable[str], extra: Mapping[str, bytes]
) -> None:
    """Copy an FMU with its GUID set, files added, entries sorted, and no trace of when and where it was built.

    Script and modules get names that no other FMU has: FMUs in one process share Python's modules, by name, and would
    look for a package in the folder of the one that came first, which may be gone or of another version.
    """
    suffix = f"_{identity[:8]}"
    tops = {path: path.partition("/")[0].removesuffix(".py") for path in files if path.endswith(".py")}
    own = {f"resources/{path}": f"resources/{top}{suffix}{path[len(top) :]}" for path, top in tops.items()}
    with zipfile.ZipFile(raw) as source, zipfile.ZipFile(target, "x", zipfile.ZIP_DEFLATED) as copy:
        # Nobody builds this FMU from C++: FMI 3.0 asks for a build description beside sources.
        kept = {path for path in source.namelist() if not path.startswith("sources/")}
        for path in sorted(kept | set(extra), key=lambda path: own.get(path, path)):
            content = extra[path] if path in extra else source.read(path)
            if path == "modelDescription.xml":
                content = _identified(content, identity)
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
    """Return a source that imports these modules under their names in the FMU.

    Replaced are `from a.b import c`, `import a.b as c` and `import a`; no other import is.
    """
    names = "|".join(sorted(modules)).encode()
    source = re.sub(rb"^(\s*)import (%b)(?=\s*(#|$))" % names, rb"\1import \2 as \2", source, flags=re.MULTILINE)
    own = rb"\1\2%b" % suffix.encode()
    return re.sub(rb"^(\s*(?:from|import) )(%b)\b" % names, own, source, flags=re.MULTILINE)


def _identified(description: bytes, identity: str) -> bytes:
    root = ElementTree.fromstring(description)
    root.set("guid" if root.get("fmiVersion") == "2.0" else "instantiationToken", identity)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
