"""The FMUs of the benchmarks that are not of fmu_models: one small model, in C and by pythonfmu."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy

SOURCES = Path(__file__).parent / "native"
HEADERS = Path(fmpy.__file__).parent / "c-code"


def compile_c(source: str, target: Path, *options: str) -> Path:
    """A file of native/ compiled with gcc; returns target. Raises RuntimeError where it cannot be."""
    gcc = shutil.which("gcc")
    if gcc is None:
        raise RuntimeError("gcc is not installed")
    command = [gcc, "-O2", f"-I{HEADERS}", "-o", target, SOURCES / source, *options]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"gcc failed: {result.stderr.strip().splitlines()[-1]}")
    return target


def build_native(folder: Path) -> Path:
    """oscillator.c as folder/native/Oscillator.fmu. Raises RuntimeError where it cannot be compiled."""
    target = folder / "native" / "Oscillator.fmu"
    target.parent.mkdir(parents=True, exist_ok=True)
    library = compile_c("oscillator.c", target.with_suffix(fmpy.sharedLibraryExtension), "-shared", "-fPIC")
    with zipfile.ZipFile(target, "w") as fmu:
        fmu.write(SOURCES / "modelDescription.xml", "modelDescription.xml")
        fmu.write(library, f"binaries/{fmpy.platform}/Oscillator{library.suffix}")
    return target


def build_python(folder: Path) -> Path:
    """oscillator_fmu.py built by pythonfmu, as folder/python/Oscillator.fmu."""
    target = folder / "python" / "Oscillator.fmu"
    target.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", SOURCES / "oscillator_fmu.py", "-d", target.parent]
    subprocess.run(command, check=True, capture_output=True)  # a process of its own: the builder imports the script
    return target
