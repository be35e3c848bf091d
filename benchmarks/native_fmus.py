"""FMUs that are not of fmu_models: models in C, and one by pythonfmu.

`python -m benchmarks.native_fmus FOLDER` compiles those of docs/your-own-fmu.md, tests/foreign, into a folder.
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
    """A C file compiled with gcc; returns target. Raises RuntimeError where it cannot be."""
    gcc = shutil.which("gcc")
    if gcc is None:
        raise RuntimeError("gcc is not installed")
    command = [gcc, "-O2", f"-I{HEADERS}", f"-I{SOURCES}", "-o", target, source, *options]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"gcc failed: {result.stderr.strip().splitlines()[-1]}")
    return target


def build_c(source: Path, description: str, target: Path, *options: str) -> Path:
    """A model that native/fmi_model.h makes an FMU of, and its modelDescription.xml, as target; raises RuntimeError.

    The FMI version is that of the description.
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
    """oscillator.c as folder/native/Oscillator.fmu. Raises RuntimeError where it cannot be compiled."""
    target = folder / "native" / "Oscillator.fmu"
    target.parent.mkdir(parents=True, exist_ok=True)
    return build_c(SOURCES / "oscillator.c", (SOURCES / "modelDescription.xml").read_text(), target)


def build_foreign(folder: Path) -> None:
    """Axis (FMI 2.0), Axis-3 (FMI 3.0, model exchange too), Axis-ME (FMI 2.0, model exchange only), AxisController.

    Raises RuntimeError where they cannot be compiled.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for description in FOREIGN.glob("*.xml"):
        source = FOREIGN / f"{description.stem.partition('-')[0]}.c"
        build_c(source, description.read_text(), folder / f"{description.stem}.fmu")
    interface, text = '<ModelExchange modelIdentifier="Axis"/>', (FOREIGN / "Axis.xml").read_text()
    build_c(FOREIGN / "Axis.c", re.sub("<CoSimulation.*?>", interface, text), folder / "Axis-ME.fmu", "-DONLY_EXCHANGE")


def build_python(folder: Path) -> Path:
    """oscillator_fmu.py built by pythonfmu, as folder/python/Oscillator.fmu."""
    target = folder / "python" / "Oscillator.fmu"
    target.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", SOURCES / "oscillator_fmu.py", "-d", target.parent]
    subprocess.run(command, check=True, capture_output=True)  # a process of its own: the builder imports the script
    return target


if __name__ == "__main__":
    build_foreign(Path(sys.argv[1]))
