"""Builders of FMUs that do not come from fmu_models: models in C, and one by pythonfmu.

`python -m benchmarks.native_fmus FOLDER` builds the FMUs of docs/your-own-fmu.md (tests/foreign) in a folder.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import fmpy

SOURCES = Path(__file__).parent / "native"
FOREIGN = Path(__file__).parents[1] / "tests" / "foreign"
HEADERS = Path(fmpy.__file__).parent / "c-code"


def compile_c(source: Path, target: Path, *options: str) -> Path:
    """Compile a C file with gcc and return target. Raises RuntimeError if that fails."""
    gcc = shutil.which("gcc")
    if gcc is None:
        raise RuntimeError("gcc is not installed")
    command = [gcc, "-O2", f"-I{HEADERS}", f"-I{SOURCES}", "-o", target, source, *options]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"gcc failed: {result.stderr.strip().splitlines()[-1]}")
    return target


def build_c(source: Path, description: str, target: Path, *options: str) -> Path:
    """Build an FMU from a model for native/fmi_model.h and its modelDescription.xml, and return target.

    The FMI version is that of the description. Raises RuntimeError if the model cannot be compiled.
    """
    identifier = re.search(r'modelIdentifier="(\w+)"', description)
    is_fmi_3 = 'fmiVersion="3' in description
    assert identifier
    library = f"{identifier[1]}{fmpy.sharedLibraryExtension}"
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(target, "w") as fmu:
        options = ("-shared", "-fPIC", f"-DFMI={3 if is_fmi_3 else 2}", *options, "-lm")
        compiled = compile_c(source, Path(folder) / library, *options)
        fmu.writestr("modelDescription.xml", description)
        fmu.write(compiled, f"binaries/{fmpy.platform_tuple if is_fmi_3 else fmpy.platform}/{library}")
    return target


def build_native(folder: Path) -> Path:
    """Build folder/native/Oscillator.fmu from oscillator.c. Raises RuntimeError if it cannot be compiled."""
    target = folder / "native" / "Oscillator.fmu"
    target.parent.mkdir(parents=True, exist_ok=True)
    return build_c(SOURCES / "oscillator.c", (SOURCES / "modelDescription.xml").read_text(), target)


def build_foreign(folder: Path) -> None:
    """Build Axis (FMI 2.0), Axis-3 (FMI 3.0, also model exchange), Axis-ME (model exchange only) and AxisController.

    Raises RuntimeError if one cannot be compiled.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for description in FOREIGN.glob("*.xml"):
        source = FOREIGN / f"{description.stem.partition('-')[0]}.c"
        build_c(source, description.read_text(), folder / f"{description.stem}.fmu")
    interface, text = '<ModelExchange modelIdentifier="Axis"/>', (FOREIGN / "Axis.xml").read_text()
    build_c(FOREIGN / "Axis.c", re.sub("<CoSimulation.*?>", interface, text), folder / "Axis-ME.fmu", "-DONLY_EXCHANGE")


def build_python(folder: Path) -> Path:
    """Build folder/python/Oscillator.fmu from oscillator_fmu.py with pythonfmu."""
    target = folder / "python" / "Oscillator.fmu"
    target.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", SOURCES / "oscillator_fmu.py", "-d", target.parent]
    subprocess.run(command, check=True, capture_output=True)  # a process of its own: the builder imports the script
    return target


if __name__ == "__main__":
    build_foreign(Path(sys.argv[1]))
