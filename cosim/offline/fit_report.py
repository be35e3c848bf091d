"""Report of an estimation from logs: in words for the terminal, and as files."""

from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimator.offline.identifiability_report import findings

from ..files import write_json, write_text
from ..runs.run_files import ESTIMATES
from ..runs.series import write_csv
from ..ssv.document import ParameterValue, to_ssv
from ..text_table import aligned, counted, with_std
from .estimate import Estimation
from .misfit_over_log import misfit_over_log, worst_part

_ROUGH: Final = 0.5
"""Noise of the FMU's solver, in standard deviations of the noise, from which it is reported."""
_BIASED: Final = 0.5
"""Change of an estimate by a finer step, in standard deviations, from which it is reported."""
_OUTLYING: Final = 5.0
"""Size of a residual, in standard deviations of the misfit, from which it is counted as an outlier."""
_CORRELATED: Final = 0.3
"""Autocorrelation of the residuals above which it is reported."""


def report(found: Estimation) -> str:
    """Return the report for the terminal."""
    request, rows = found.request, sum(len(w.time) for w in found.windows)
    n_fit = sum(w.n_fit for w in found.windows)
    logs = ", ".join(path.name for path in (*request.logs, *request.validation))
    split = (
        f"fitted to {n_fit} of {counted(rows, 'row')}, {rows - n_fit} held out"
        if n_fit < rows
        else f"fitted to all {counted(rows, 'row')}"
    )
    lines = [
        f"{request.fmu.name}, {logs}: {split}",
        f"{counted(len(found.evaluations), 'roll-out')}, method {request.method}, {_loss(found)}seed {request.seed}, "
        f"{found.seconds:.1f} s",
    ]
    lines += [f"warning: {warning}" for warning in found.warnings]
    return "\n".join(
        [*lines, "", *aligned(_parameter_rows(found)), "", *aligned(_output_rows(found)), "", *words(found)]
    )


def _loss(found: Estimation) -> str:
    """Return the loss in words, empty where it is the square."""
    loss = found.fit.loss
    return "" if loss.is_linear else f"loss {loss.name} (f_scale {loss.scale:g}), "


def words(found: Estimation) -> list[str]:
    """Return the findings on fit and identifiability, a sentence each."""
    return [*_of_fit(found), *_of_identifiability(found)]


def summary(found: Estimation) -> dict[str, Any]:
    """Return the whole result as JSON values, with its findings in words."""
    return numbers(found) | {"words": words(found)}


def numbers(found: Estimation) -> dict[str, Any]:
    """Return the whole result as JSON values, without words: nothing of the report is made."""
    fit, request = found.fit, found.request
    return {
        "fmu": str(request.fmu),
        "logs": [str(path) for path in request.logs],
        "validation": [str(path) for path in request.validation],
        "method": request.method,
        "loss": request.loss,
        "f_scale": request.f_scale,
        "outliers": _n_outliers(found)[0],
        "seed": request.seed,
        "parameters": {
            p.name: {
                "unit": p.unit, "value": float(value), "std": float(std), "white_std": float(white_std),
                "is_identifiable": is_identifiable,
                "before": float(before), "lower": p.lower, "upper": p.upper, "scale": p.scale,
            }
            | _profile_of(found, p.name)
            for p, value, std, white_std, is_identifiable, before in zip(
                found.space, fit.theta, fit.std, fit.white_std, found.is_identifiable, found.nominal, strict=True
            )
        },
        "misfit": fit.misfit,
        "solver_noise": fit.solver_noise,
        "autocorrelation": fit.autocorrelation,
        "singular_values": fit.information.singular_values.tolist(),
        "directions": fit.information.directions.tolist(),
        "outputs": {
            name: {
                "noise": float(found.noise[i]),
                "rms": {
                    f"{part}_{when}": float(found.rms(outputs, part == "held_out")[i])
                    for part in ("fit", "held_out")
                    for when, outputs in (("before", found.before), ("after", found.after))
                },
            }
            for i, name in enumerate(request.measured)
        },
        "finer_step": asdict(found.finer) if found.finer else None,
        "misfit_over_log": [part._asdict() for part in misfit_over_log(found)],
        "windows": [{"name": w.name, "rows": len(w.time), "rows_fitted": w.n_fit} for w in found.windows],
        "warnings": list(found.warnings),
        "rollouts": len(found.evaluations),
        "failures": dict(found.failures),
        "seconds": found.seconds,
    }  # fmt: skip


def _profile_of(found: Estimation, name: str) -> dict[str, Any]:
    """Return the profile of a parameter as JSON values; empty where none was made."""
    if not found.profiles:
        return {}
    p = found.profiles[found.space.names.index(name)]
    ends: dict[str, Any] = {"lower": p.lower, "upper": p.upper, "is_flat": p.is_flat}
    for end, numbers_of in (("lower_set_by", p.lower_set_by), ("upper_set_by", p.upper_set_by)):
        ends[end] = [found.space.names[k] for k in numbers_of]
    return {"profile": ends | {"values": p.values.tolist(), "rise": p.rise.tolist()}}


def write_files(found: Estimation, folder: Path) -> None:
    """Write estimates.ssv, estimate.json, candidates.csv, and fit.csv with measured and simulated outputs.

    With own values there is an SSV file for each log: see ssv_files. The numbers are on disk before the report is made
    of them. Raises FolderError.
    """
    for path, text in ssv_files(found).items():
        write_text(folder / path, text)
    write_json(folder / "estimate.json", numbers(found))
    theta = np.array([candidate for candidate, _, _ in found.evaluations])
    costs = [cost for _, cost, _ in found.evaluations]
    write_csv(folder / "candidates.csv", dict(zip(found.space.names, theta.T, strict=True)) | {"sum_of_squares": costs})
    write_csv(folder / "fit.csv", _series(found))
    write_json(folder / "estimate.json", summary(found))


def ssv_files(found: Estimation) -> dict[str, str]:
    """Return the estimates as SSV by file name: one file, or one for each log where parameters have own values."""
    if not found.request.own:
        return {ESTIMATES: estimates_ssv(found)}
    logs, stem = found.request.logs, Path(ESTIMATES)
    return {f"{stem.stem}-{i}{stem.suffix}": estimates_ssv(found, log) for i, log in enumerate(logs, start=1)}


def estimates_ssv(found: Estimation, log: Path | None = None) -> str:
    """Return the estimates as SSV, with their units; log: the one whose own values are taken."""
    own = found.request.of_one_log
    values = [
        ParameterValue(own[p.name][0] if p.name in own else p.name, float(v), p.unit)
        for p, v in zip(found.space, found.fit.theta, strict=True)
        if p.name not in own or own[p.name][1] == log
    ]
    return to_ssv(f"{found.request.fmu.stem} estimates", values, found.component.units)


def _series(found: Estimation) -> dict[str, Any]:
    windows = found.windows
    series: dict[str, Any] = {
        "window": np.repeat(np.arange(len(windows)), [len(w.time) for w in windows]),
        "time": np.concatenate([w.time for w in windows]),
        "is_held_out": np.concatenate([(np.arange(len(w.time)) >= w.n_fit).astype(int) for w in windows]),
    }
    for i, name in enumerate(found.request.measured):
        series[f"{name} measured"] = np.concatenate([w.measured[:, i] for w in windows])
        for when, outputs in (("before", found.before), ("after", found.after)):
            parts = [
                np.full(len(w.time), np.nan) if y is None else y[:, i] for w, y in zip(windows, outputs, strict=True)
            ]
            series[f"{name} {when}"] = np.concatenate(parts)
    return series


def _parameter_rows(found: Estimation) -> list[list[str]]:
    rows = [["parameter", "unit", "estimate ± std", "std / value", "before", "bounds"]]
    for p, value, std, before in zip(found.space, found.fit.theta, found.fit.std, found.nominal, strict=True):
        share = f"{100.0 * std / abs(value):.2g} %" if value else "-"
        rows.append([p.name, p.unit, with_std(value, std), share, f"{before:.6g}", f"{p.lower:g} to {p.upper:g}"])
    return rows


def _output_rows(found: Estimation) -> list[list[str]]:
    rows = [["rms error", "unit", "noise", "fit: before", "after", "held out: before", "after"]]
    columns = [found.rms(y, is_held_out) for is_held_out in (False, True) for y in (found.before, found.after)]
    for i, name in enumerate(found.request.measured):
        unit = found.component.unit(name)
        errors = [f"{column[i]:.3g}" if isfinite(column[i]) else "-" for column in columns]
        rows.append([name, unit.name if unit else "1", f"{found.noise[i]:.2g}", *errors])
    return rows


def _of_fit(found: Estimation) -> list[str]:
    fit = found.fit
    sentences = [f"The residuals are {fit.misfit:.3g} times the noise (root mean square)."]
    if fit.misfit > 2.0:
        sentences = [
            f"The residuals are {fit.misfit:.3g} times the noise: something is missing from the model, the search has "
            "not found the best fit (--evaluations, --method multi-start), or a start value is wrong (--start)."
        ]
    if not fit.loss.is_linear:
        n, n_rows = _n_outliers(found)
        sentences.append(
            f"Under the loss {fit.loss.name}: {n} of {counted(n_rows, 'measured value')} lie more than {_OUTLYING:g} "
            "standard deviations off, and hardly count; the errors above and ± are those under the loss."
        )
    if fit.solver_noise > _ROUGH:
        sentences.append(
            f"Between parameters that are all but equal the FMU's results scatter by {fit.solver_noise:.2g} times the "
            "noise, by its own solver: give it a smaller tolerance, if it has one. On an unstable plant rounding "
            "grows as well: give it shorter windows (--window, which may be repeated)."
        )
    if fit.autocorrelation > _CORRELATED:
        text = f"The residuals are correlated from row to row ({fit.autocorrelation:.2f}): they are more than noise."
        larger = f"{fit.inflation.max():.2g}"
        sentences.append(text if larger == "1" else f"{text} ± includes it, and is up to {larger} times as large.")
    sentences += _of_step(found)
    if told := worst_part(found):
        sentences.append(told)
    inside, outside = (found.rms(found.after, is_held_out) for is_held_out in (False, True))
    for name, fitted, held_out in zip(found.request.measured, inside, outside, strict=True):
        if held_out > 2.0 * fitted:
            sentences.append(
                f"On the held-out rows the error of {name} is {held_out:.3g}, {held_out / fitted:.1f} times that on "
                "the fitted rows: do not trust the fit beyond them."
            )
    n = sum(found.failures.values())
    if n:
        reason, _ = max(found.failures.items(), key=lambda item: item[1])
        sentences.append(
            f"{n} of {len(found.evaluations)} roll-outs failed and count as bad candidates; one reason: {reason}."
        )
    return sentences


def _n_outliers(found: Estimation) -> tuple[int, int]:
    """Return the number of fitted values far off, in the misfit's standard deviations, and that of all of them."""
    residuals = [
        ((y - w.measured) / found.noise)[: w.n_fit].ravel()
        for y, w in zip(found.after, found.windows, strict=True)
        if y is not None and w.n_fit
    ]
    r = np.concatenate(residuals) if residuals else np.empty(0)
    return int(np.sum(np.abs(r) > _OUTLYING * max(found.fit.misfit, 1.0))), int(np.sum(np.isfinite(r)))


def _of_step(found: Estimation) -> list[str]:
    """Return a sentence on the bias by the FMU's own solver, if half the step shows one."""
    if found.finer is None:
        return []
    shares = {name: change / found.std[name] for name, change in found.finer.change.items() if found.std[name] > 0.0}
    name = max(shares, key=lambda name: abs(shares[name]))
    if abs(shares[name]) < _BIASED:
        return []
    return [
        f"At half the communication step, {found.finer.step:.4g} s, {name} would change by "
        f"{found.finer.change[name]:+.2g} ({abs(shares[name]):.2g} standard deviations): the FMU's own solver is too "
        f"coarse; try a finer step, --step {found.finer.step:.4g}."
    ]


def _of_identifiability(found: Estimation) -> list[str]:
    fit, space = found.fit, found.space
    sentences = [*findings(fit.information, space, fit.theta), *_of_profiles(found)]
    if all(found.is_identifiable):
        sentences.append("Each parameter is identifiable." if len(space) > 1 else "The parameter is identifiable.")
    return sentences


def _bounds_of(found: Estimation, numbers_of: Sequence[int]) -> str:
    """Return "the bounds of a and b" for the parameters of these numbers."""
    names = [found.space.names[k] for k in numbers_of]
    return f"the bound{'s' if len(names) > 1 else ''} of {' and '.join(names)}"


def _of_profiles(found: Estimation) -> list[str]:
    """Return a sentence for each profile: its 95 % interval, what sets its ends, or the side to which it is open."""
    sentences: list[str] = []
    for p, one in zip(found.space, found.profiles, strict=False):
        if one.is_flat:
            sentences.append(f"{p.name} is not identifiable: its profile is flat, the others make up for any value.")
        elif one.lower is None or one.upper is None:
            ends = [text for text, end in (("below", one.lower), ("above", one.upper)) if end is None]
            sentences.append(f"{p.name} is not identifiable: its profile is open {' and '.join(ends)}.")
        elif not one.is_identifiable:
            ends = [
                f"its {side} end by {_bounds_of(found, set_by)}"
                for side, set_by in (("lower", one.lower_set_by), ("upper", one.upper_set_by))
                if set_by
            ]
            sentences.append(
                f"{p.name} is not identifiable: 95 % by its profile, {one.lower:.6g} to {one.upper:.6g}, is set not by "
                f"the data but {' and '.join(ends)}."
            )
        else:
            sentences.append(f"95 % of {p.name} by its profile: {one.lower:.6g} to {one.upper:.6g}.")
    return sentences
