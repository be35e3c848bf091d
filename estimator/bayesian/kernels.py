"""GPy's kernels on the unit cube: from a text such as "Matern52 + Linear", or the user's own objects.

A text comes from a scenario, perhaps a stranger's. It is parsed, never evaluated: its names are those of kernels in
GPy.kern, their options numbers.
"""

import ast
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import Parameter, signature
from typing import Any, Final

import numpy as np

from ..space import Vector

OwnKernel = Callable[[int], Any] | Any
"""A GPy.kern.Kern, or a function of the number of dimensions that returns one."""
_LONGEST: Final = 200
"""Number of characters in a kernel's text."""
_LARGEST: Final = 100
"""Largest whole number in a kernel's text: they are orders and numbers of terms, which cost memory."""
_RELATIVE: Final = 1e-6
"""Eigenvalue of a covariance, relative to its largest entry, below which it is negative not by rounding alone."""


@dataclass(frozen=True)
class KernelBounds:
    """Bounds of the hyperparameters of kernels that are made from a text; equal ones fix them."""

    variance: tuple[float, float]
    lengthscale: tuple[float, float]
    prior: tuple[Any, Any] | None = None
    """Mean and standard deviation of a lengthscale's logarithm."""


def check_kernel(text: str) -> None:
    """Raise ValueError for a text that is no sum and product of GPy's kernels."""
    for name, options in _leaves(_tree(text)):
        _check_options(_kernel_class(name), name, options)


def kernel_from_text(text: str, n_dimensions: int, bounds: KernelBounds) -> Any:
    """Return GPy's kernel for a text, with bounds and prior, and a lengthscale a dimension where it may have.

    Raises ValueError.
    """
    check_kernel(text)
    kernel = _tried(lambda: _built(_tree(text), n_dimensions), f"'{text}'", n_dimensions)
    limits = {"lengthscale": bounds.lengthscale, "variance": bounds.variance, "variances": bounds.variance}
    for parameter in kernel.flattened_parameters:
        if parameter.name not in limits:
            continue
        lower, upper = limits[parameter.name]
        if not (lower <= parameter.values.min() and parameter.values.max() <= upper):
            raise ValueError(f"{parameter.name} in kernel '{text}' must be from {lower:g} to {upper:g}.")
        if bounds.prior and parameter.name == "lengthscale":  # first: it sets a constraint of its own
            _set_prior(parameter, bounds.prior)
        constrain(parameter, (lower, upper))
    return kernel


def fix_scale(kernel: Any) -> bool:
    """Fix the variances that scale the whole kernel, and leave those that weigh its parts; return whether there are."""
    import GPy

    if isinstance(kernel, GPy.kern.Prod):
        are_fixed = [fix_scale(part) for part in kernel.parts]
        return all(are_fixed)
    if isinstance(kernel, GPy.kern.Add):
        return any(fix_scale(part) for part in kernel.parts)
    if not hasattr(kernel, "variance"):
        return False
    kernel.variance.constrain_fixed(1.0, warning=False)
    return True


def own_kernel(kernel: OwnKernel, n_dimensions: int) -> Any:
    """Return a copy of the user's kernel, with the bounds and priors that it has. Raises ValueError."""
    import GPy

    given: Any = kernel
    is_object: bool = isinstance(kernel, GPy.kern.Kern)
    if not is_object and not callable(kernel):
        raise ValueError(f"kernel must be a GPy.kern.Kern or a function that makes one, got {given!r}.")
    name = getattr(given, "name", getattr(given, "__name__", type(given).__name__))
    return _tried(given.copy if is_object else lambda: given(n_dimensions).copy(), f"'{name}'", n_dimensions)


def constrain(parameter: Any, bounds: tuple[float, float]) -> None:
    """Constrain GPy's parameter to its bounds, or fix it where they are equal."""
    if bounds[0] < bounds[1]:
        parameter.constrain_bounded(*bounds, warning=False)
    else:
        parameter.constrain_fixed(bounds[0], warning=False)


def _set_prior(parameter: Any, prior: tuple[Any, Any]) -> None:
    import GPy

    parameter.set_prior(GPy.priors.LogGaussian(*prior), warning=False)


def _tree(text: str) -> ast.expr:
    if len(text) > _LONGEST:
        raise ValueError(f"kernel must have at most {_LONGEST} characters, got {len(text)}.")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as e:
        raise _unreadable(text) from e


def _unreadable(text: str) -> ValueError:
    return ValueError(
        f"kernel must be names of GPy's kernels with + and *, such as \"Matern52 + Linear\", got '{text}'."
    )


def _leaves(node: ast.expr) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and options of each kernel in an expression."""
    match node:
        case ast.BinOp(left, ast.Add() | ast.Mult(), right):
            yield from _leaves(left)
            yield from _leaves(right)
        case ast.Name(name):
            yield name, {}
        case ast.Call(ast.Name(name), [], keywords) if all(k.arg for k in keywords):
            try:
                yield name, {str(k.arg): ast.literal_eval(k.value) for k in keywords}
            except ValueError as e:
                raise _unreadable(ast.unparse(node)) from e
        case _:
            raise _unreadable(ast.unparse(node))


def _built(node: ast.expr, n_dimensions: int) -> Any:
    if isinstance(node, ast.BinOp):
        left, right = _built(node.left, n_dimensions), _built(node.right, n_dimensions)
        return left + right if isinstance(node.op, ast.Add) else left * right
    ((name, options),) = _leaves(node)
    kind = _kernel_class(name)
    one_each = {"ARD": True} if "ARD" in signature(kind.__init__).parameters else {}
    return kind(len(options.get("active_dims", range(n_dimensions))), **(one_each | options))


def _kernel_class(name: str) -> type[Any]:
    import GPy

    kernels: Mapping[str, Any] = {
        key: kind
        for key, kind in vars(GPy.kern).items()
        if isinstance(kind, type) and issubclass(kind, GPy.kern.Kern) and not key.startswith("_")
    }
    if name not in kernels:
        near = get_close_matches(name, kernels, 1)
        raise ValueError(f"GPy has no kernel '{name}'{f'; did you mean {near[0]!r}?' if near else '.'}")
    return kernels[name]


def _check_options(kind: type[Any], name: str, options: Mapping[str, Any]) -> None:
    known = signature(kind.__init__).parameters
    plain = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    needed = [
        k for k, p in known.items() if p.default is p.empty and p.kind in plain and k not in ("self", "input_dim")
    ]
    if needed or "input_dim" not in known:
        raise ValueError(f"kernel '{name}' needs more than a text can say; make it in Python.")
    allowed = {key for key, p in known.items() if p.kind in plain} - {"self", "input_dim", "name", "useGPU"}
    for key, value in options.items():
        if key not in allowed:
            raise ValueError(f"kernel '{name}' has no option '{key}'; it has {', '.join(sorted(allowed))}.")
        values: Any = value if isinstance(value, list) else [value]
        if not values or not all(isinstance(v, bool | int | float) and 0 <= v <= _LARGEST for v in values):
            raise ValueError(f"{key} of kernel '{name}' must be numbers from 0 to {_LARGEST}, got {value}.")
        if key == "active_dims" and not isinstance(value, list):
            raise ValueError(f"active_dims of kernel '{name}' must be a list of dimensions, from 0, got {value}.")


def _tried(make: Callable[[], Any], name: str, n_dimensions: int) -> Any:
    """Return the kernel that is made, once its covariance of a few places is found to be one."""
    Z = (0.5 + np.outer(np.arange(8), 0.5 ** (np.arange(n_dimensions) + 1.0))) % 1.0 * 0.9 + 0.01 * np.arange(8)[
        :, None
    ]
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            kernel = make()
            K: Vector = np.asarray(kernel.K(Z))
            has_diagonal = np.allclose(kernel.Kdiag(Z), np.diagonal(K))
            kernel.update_gradients_full(np.eye(len(Z)), Z)
    except Exception as e:  # GPy asserts, and raises whatever NumPy does
        why = str(e) or type(e).__name__
        raise ValueError(f"kernel {name} does not work in {n_dimensions} dimensions: {why}".rstrip(".") + ".") from e
    is_matrix = has_diagonal and K.shape == (8, 8) and bool(np.isfinite(K).all())
    if not is_matrix or np.linalg.eigvalsh(K).min() < -_RELATIVE * np.abs(K).max():
        raise ValueError(f"kernel {name} is no covariance in {n_dimensions} dimensions.")
    return kernel
