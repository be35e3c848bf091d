"""CVODE of SUNDIALS, from the libraries that FMPy ships: backward differentiation formulas, and roots on the way.

Hindmarsh et al. (2005), "SUNDIALS: Suite of nonlinear and differential/algebraic equation solvers", ACM Transactions on
Mathematical Software 31(3).
"""

import ctypes
import math
from collections.abc import Callable
from ctypes import byref, c_double, c_int, c_void_p
from typing import Any, Final

try:
    from fmpy import sundials
    from fmpy.sundials.libraries import sundials_core, sundials_cvode
    from fmpy.sundials.sundials_types import SUNContext, SUNErrHandlerFn
except OSError as error:  # FMPy ships the libraries of some platforms only
    raise ImportError(f"FMPy has no CVODE for this machine: {error}") from error

_SHORTEST: Final = 1e-12
_ULPS: Final = 4
_ONE_STEP: Final = 2
_ROOT_RETURN: Final = 2
_AGAIN, _NEVER = 1, -1  # answers of a callback: try a smaller step; give up

Evaluate = Callable[[float, Any, Any], bool]
"""Called with t [s], the states and an array to fill; returns whether it has values there. May raise."""


def _function(library: Any, name: str, *arguments: Any) -> Any:
    function = library[name]  # one that FMPy does not use
    function.argtypes, function.restype = arguments, c_int
    return function


_set_min_step: Final = _function(sundials_cvode, "CVodeSetMinStep", c_void_p, c_double)
_set_stop_time: Final = _function(sundials_cvode, "CVodeSetStopTime", c_void_p, c_double)
_free_solver: Final = _function(sundials_cvode, "CVodeFree", c_void_p)
_free_linear_solver: Final = _function(sundials_core, "SUNLinSolFree", c_void_p)
_free_matrix: Final = _function(sundials_core, "SUNMatDestroy", c_void_p)
_clear_error_handlers: Final = _function(sundials_core, "SUNContext_ClearErrHandlers", SUNContext)
_free_context: Final = _function(sundials_core, "SUNContext_Free", c_void_p)


class SolverError(Exception):
    """A step that CVODE cannot take, in its words."""


class Cvode:
    """Solver of xdot = f(t, x) that stops where one of the functions z(t, x) changes its sign.

    1. restart   begins at a time, from the values in `x`; what came before has no influence
    2. step      takes one internal step, as large as the tolerance allows, any number of times
    3. close     frees it
    """

    def __init__(self, n: int, n_roots: int, f: Evaluate, z: Evaluate, tolerance: float) -> None:
        """n >= 1: number of states; tolerance: relative, of a step's error; that of a state's size: see restart."""
        self._n, self._n_roots, self._tolerance = n, n_roots, tolerance
        self._error: Exception | None = None
        self._words = ""
        self._has_begun = False
        self._context: Any = SUNContext()
        sundials.SUNContext_Create(0, byref(self._context))
        self._vectors: Any = [sundials.N_VNew_Serial(n, self._context) for _ in range(2)]
        self.x, self._absolute = (sundials.NV_DATA_S(vector) for vector in self._vectors)
        """States (n,), as a pointer to doubles."""
        self._matrix: Any = sundials.SUNDenseMatrix(n, n, self._context)
        self._linear: Any = sundials.SUNLinSol_Dense(self._vectors[0], self._matrix, self._context)
        self._solver = c_void_p(sundials.CVodeCreate(sundials.CV_BDF, self._context))
        self._callbacks: Any = (
            sundials.CVRhsFn(lambda t, x, rates, _: self._called(f, t, x, sundials.NV_DATA_S(rates))),
            sundials.CVRootFn(lambda t, x, values, _: self._called(z, t, x, values)),
            SUNErrHandlerFn(self._take_words),
        )
        self._t = c_double()

    def restart(self, t: float, nominals: Any, span: float) -> None:
        """Begin at t [s] from `x`; nominals (n,): size of each state, of which the tolerance is a share.

        span: time to be integrated over [s]; where a step cannot be a trillionth of it, it fails.
        """
        for i in range(self._n):
            self._absolute[i] = self._tolerance * (abs(nominals[i]) or 1.0)
        if not self._has_begun:
            self._begin(t)
            self._has_begun = True
        else:
            self._check(sundials.CVodeReInit(self._solver, t, self._vectors[0]))
        self._check(_set_min_step(self._solver, max(_SHORTEST * span, _ULPS * math.ulp(t))))

    def step(self, until: float) -> tuple[float, bool]:
        """Take a step that does not pass `until` [s]; return the time reached, and whether z changed its sign there.

        `x` has the states then. Raises SolverError, and what f and z have raised.
        """
        self._check(_set_stop_time(self._solver, until))
        status = sundials.CVode(self._solver, until, self._vectors[0], byref(self._t), _ONE_STEP)
        self._check(status)
        return self._t.value, status == _ROOT_RETURN

    def close(self) -> None:
        """Free the solver; it must not be used afterwards."""
        _free_solver(byref(self._solver))
        _free_linear_solver(self._linear)
        _free_matrix(self._matrix)
        for vector in self._vectors:
            sundials.N_VDestroy_Serial(vector)
        _free_context(byref(self._context))

    def _begin(self, t: float) -> None:
        f, z, take_words = self._callbacks
        _clear_error_handlers(self._context)  # the one that is there prints
        sundials.SUNContext_PushErrHandler(self._context, take_words, None)
        self._check(sundials.CVodeInit(self._solver, f, t, self._vectors[0]))
        self._check(sundials.CVodeSVtolerances(self._solver, self._tolerance, self._vectors[1]))
        if self._n_roots:
            self._check(sundials.CVodeRootInit(self._solver, self._n_roots, z))
            self._check(sundials.CVodeSetNoInactiveRootWarn(self._solver))
        self._check(sundials.CVodeSetLinearSolver(self._solver, self._linear, self._matrix))

    def _called(self, function: Evaluate, t: float, x: Any, values: Any) -> int:
        try:
            return 0 if function(t, sundials.NV_DATA_S(x), values) else _AGAIN
        except Exception as error:  # it cannot pass through the C code that has called
            self._error = error
            return _NEVER

    def _check(self, status: int) -> None:
        if status >= 0:
            return
        error, self._error = self._error, None
        if error is not None:
            raise error
        raise SolverError(self._words or f"CVODE gave up with the code {status}")

    def _take_words(self, *arguments: Any) -> None:
        self._words = arguments[3].decode("utf-8", "replace")


def is_finite(values: Any, n: int) -> bool:
    """Return whether an array's first n values are all finite numbers."""
    return math.isfinite(sum(values[:n])) or all(map(math.isfinite, values[:n]))


def doubles(n: int) -> Any:
    """Return an array of n doubles, at least one."""
    return (ctypes.c_double * max(n, 1))()
