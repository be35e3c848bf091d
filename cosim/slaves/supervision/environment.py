"""Environment of an FMU's process: the variables that FMUs need. The others, such as access keys, it never sees."""

import os
import sys
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Final

from ...blas_threads import ONE_THREAD
from .descendants import VARIABLE

PASSED: Final[Sequence[str]] = (
    "PATH", "HOME", "USER", "LOGNAME", "SHELL", "TZ", "TZDIR", "LANG", "LANGUAGE", "LC_*", "TMPDIR", "TEMP", "TMP",
    "LD_LIBRARY_PATH", "LD_PRELOAD", "LD_BIND_NOW", "DYLD_*", "GLIBC_TUNABLES", "MALLOC_*",
    "PYTHON*", "VIRTUAL_ENV", "CONDA_PREFIX",
    "OMP_*", "GOMP_*", "KMP_*", "MKL_*", "OPENBLAS_*", "BLIS_*", "NUMEXPR_*",
    "*LICENSE_FILE", "RLM_LICENSE", "DYMOLA_RUNTIME_LICENSE",
)  # fmt: skip
"""Names, `*` for any text: of files, languages, libraries, Python, threads, and of licence files and servers."""
PASSED_ON_WINDOWS: Final[Sequence[str]] = (
    "SYSTEMROOT", "SYSTEMDRIVE", "WINDIR", "COMSPEC", "PATHEXT", "OS", "NUMBER_OF_PROCESSORS", "PROCESSOR_*",
    "PROGRAMDATA", "PROGRAMFILES*", "PROGRAMW6432", "COMMONPROGRAM*", "ALLUSERSPROFILE", "PUBLIC",
    "USERNAME", "USERPROFILE", "HOMEDRIVE", "HOMEPATH", "APPDATA", "LOCALAPPDATA",
)  # fmt: skip
"""Names that Windows and its C library need, in capitals, as they are there."""


def variables(more: Sequence[str], mark: str) -> dict[str, str]:
    """Return the environment of an FMU's process; more: as for `passed_on`, mark: of what it starts."""
    return passed_on(os.environ, more) | ONE_THREAD | {VARIABLE: mark}


def passed_on(environment: Mapping[str, str], more: Sequence[str] = ()) -> dict[str, str]:
    """Return the variables of an environment that an FMU's process is given; more: further names, `*` for any text."""
    names = [*PASSED, *more]
    if sys.platform == "win32":
        names = [name.upper() for name in (*names, *PASSED_ON_WINDOWS)]
    return {key: value for key, value in environment.items() if any(fnmatchcase(key, name) for name in names)}
