"""Folder of a fit: its files and pictures are on the disk before anything else is made of it."""

from collections.abc import Callable
from pathlib import Path

from estimator.offline.evaluated import FitProgress

from ..runs.record import recording
from .estimate import Estimation, estimate, with_profiles
from .fit_plot import draw_fit
from .fit_report import write_files
from .profile_plot import draw_profiles
from .request import Request


def estimate_into(folder: Path, request: Request, progress: FitProgress) -> Estimation:
    """Estimate as `estimate` does, and write the files of the fit. Raises UnfinishedError where there is no room."""
    found = estimate(request, progress)
    with recording(folder):
        write_files(found, folder)
        draw_fit(found, folder / "fit.png")
    return found


def profile_into(folder: Path, found: Estimation, progress: Callable[[int], None] = lambda k: None) -> Estimation:
    """Return the estimation with its profiles, which are written too. Raises UnfinishedError."""
    found = with_profiles(found, progress)
    with recording(folder):
        write_files(found, folder)
        draw_profiles(found, folder / "profiles.png")
    return found
