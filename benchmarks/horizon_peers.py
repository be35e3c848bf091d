"""Other people's moving-horizon estimators: do-mpc's, and one written with CasADi and Ipopt.

Both get what our `mhe` gets: the parameters as random walks in the unit cube, each sample's whitened residual, a
horizon of newest samples. do-mpc's default arrival cost has a fixed weight about its last estimate; the one in CasADi
carries an extended Kalman filter's covariance: Rao, Rawlings, Lee (2001). Models are in CasADi's symbols, as both need.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimator import ParameterSpace, Sample, Vector
from estimator.baselines.moving_horizon import MovingHorizonSettings

Symbols = Callable[[Any, Any, Any], list[Any]]
"""Derivatives of the sampled channels = f(x, u, theta), of CasADi's symbols."""


@dataclass(frozen=True)
class Problem:
    """Estimation problem of one stream of samples."""

    space: ParameterSpace
    start: Vector
    """Parameters (d,) at the start."""
    noise: tuple[float, ...]
    """Standard deviation of each sampled derivative (c,)."""
    symbols: Symbols
    settings: MovingHorizonSettings
    n_states: int
    n_inputs: int

    def theta(self, z: Any) -> list[Any]:
        """Return the parameters at a place z, in CasADi's symbols."""
        import casadi

        at = [self.space.from_unit(np.full(len(self.space), end)) for end in (0.0, 1.0)]
        return [
            low * casadi.exp(z[i] * np.log(high / low)) if p.scale == "log" else low + z[i] * (high - low)
            for i, (p, low, high) in enumerate(zip(self.space, *at, strict=True))
        ]

    def modelled(self, z: Any, data: Any) -> list[Any]:
        """Return the derivatives at z, in standard deviations; data: x and u one after the other."""
        x, u = (
            [data[first + i] for i in range(n)] for first, n in ((0, self.n_states), (self.n_states, self.n_inputs))
        )
        return [f / s for f, s in zip(self.symbols(x, u, self.theta(z)), self.noise, strict=True)]

    def known(self, sample: Sample) -> list[float]:
        """Return x and u of a sample, as `modelled` takes them."""
        return [*sample.x, *sample.u[: self.n_inputs]]

    def measured(self, sample: Sample) -> Vector:
        """Return the sampled derivatives in standard deviations."""
        return np.array(sample.xdot) / np.array(self.noise)


class DoMpcHorizon:
    """Estimator of do-mpc with its default objective."""

    def __init__(self, problem: Problem) -> None:
        do_mpc = imported_do_mpc()
        self._problem, self._data = problem, list[list[float]]()
        d, c, settings = len(problem.space), len(problem.noise), problem.settings
        model = do_mpc.model.Model("discrete")
        z = model.set_variable("_x", "z", shape=(d, 1))
        data = model.set_variable("_tvp", "data", shape=(problem.n_states + problem.n_inputs, 1))
        model.set_rhs("z", z, process_noise=True)
        for i, f in enumerate(problem.modelled(z, data)):
            model.set_meas(f"y{i}", f, meas_noise=True)
        model.setup()
        self._mhe = mhe = do_mpc.estimator.MHE(model)
        mhe.settings.t_step, mhe.settings.n_horizon, mhe.settings.meas_from_data = 1.0, settings.horizon, True
        mhe.settings.store_full_solution = False
        mhe.settings.supress_ipopt_output()
        weights = np.eye(d) / settings.spread**2, np.eye(c), np.eye(d) / settings.walk**2
        mhe.set_default_objective(P_x=weights[0], P_v=weights[1], P_w=weights[2])
        mhe.bounds["lower", "_x", "z"], mhe.bounds["upper", "_x", "z"] = 0.0, 1.0
        self._template = mhe.get_tvp_template()
        self._data.append([0.0] * (problem.n_states + problem.n_inputs))  # it tries the function
        mhe.set_tvp_fun(self._known)
        mhe.setup()
        self._data.clear()
        mhe.x0 = problem.space.to_unit(problem.start)
        mhe.set_initial_guess()

    def step(self, sample: Sample) -> Vector:
        """Take a sample; return theta (d,)."""
        self._data.append(self._problem.known(sample))
        z = self._mhe.make_step(self._problem.measured(sample)[:, None])
        return self._problem.space.from_unit(z[:, 0])

    def _known(self, _: float) -> Any:
        """Return x and u over the horizon; before it is full, the oldest as often as do-mpc takes its measurement."""
        n = self._problem.settings.horizon
        newest = self._data[-n:]
        for k, row in enumerate([newest[0]] * (n - len(newest)) + newest):
            self._template["_tvp", k] = np.array(row)
        self._template["_tvp", n] = np.array(newest[-1])
        return self._template


class CasadiHorizon:
    """Moving-horizon estimator in CasADi, solved by Ipopt from the last solution."""

    def __init__(self, problem: Problem) -> None:
        import casadi

        self._problem = problem
        d, c, n = len(problem.space), len(problem.noise), problem.settings.horizon
        width = problem.n_states + problem.n_inputs
        z, data, y = casadi.SX.sym("z", d), casadi.SX.sym("data", width), casadi.SX.sym("y", c)
        r = casadi.vertcat(*problem.modelled(z, data)) - y
        self._residual = casadi.Function("r", [z, data, y], [r, casadi.jacobian(r, z)])
        Z, rows, measured = casadi.SX.sym("Z", d, n), casadi.SX.sym("X", width, n), casadi.SX.sym("Y", c, n)
        used, mean, root = casadi.SX.sym("used", n), casadi.SX.sym("mean", d), casadi.SX.sym("root", d, d)
        cost = casadi.sumsqr(root @ (Z[:, 0] - mean))
        for k in range(n):
            cost += used[k] * casadi.sumsqr(self._residual(Z[:, k], rows[:, k], measured[:, k])[0])
            if k:
                cost += casadi.sumsqr(Z[:, k] - Z[:, k - 1]) / problem.settings.walk**2
        given = casadi.vertcat(casadi.vec(rows), casadi.vec(measured), used, mean, casadi.vec(root))
        quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
        self._solver = casadi.nlpsol("mhe", "ipopt", {"x": casadi.vec(Z), "p": given, "f": cost}, quiet)
        self._mean, self._P = problem.space.to_unit(problem.start), problem.settings.spread**2 * np.eye(d)
        self._places, self._samples = np.empty((0, d)), list[Sample]()

    def step(self, sample: Sample) -> Vector:
        """Take a sample; return theta (d,)."""
        problem, n, d = self._problem, self._problem.settings.horizon, len(self._problem.space)
        self._samples.append(sample)
        last = self._places[-1] if len(self._places) else self._mean
        self._places = np.vstack([self._places, last])
        if len(self._samples) > n:
            self._arrive(self._samples.pop(0), self._places[0])
            self._places = self._places[1:]
        n_used = len(self._samples)
        # Steps that are not there yet come after the newest sample, without a residual: they cost nothing.
        samples = [*self._samples, *[sample] * (n - n_used)]
        start = np.vstack([self._places, np.tile(last, (n - n_used, 1))])
        root = np.linalg.cholesky(np.linalg.inv(self._P)).T
        given = np.concatenate([
            np.ravel([problem.known(s) for s in samples]), np.ravel([problem.measured(s) for s in samples]),
            np.arange(n) < n_used, self._mean, root.T.ravel(),
        ])  # fmt: skip
        found = self._solver(x0=start.ravel(), p=given, lbx=0.0, ubx=1.0)
        self._places = np.array(found["x"]).reshape(n, d)[:n_used]
        return problem.space.from_unit(self._places[-1])

    def _arrive(self, sample: Sample, place: Vector) -> None:
        """Take a sample that leaves the horizon into the arrival cost: an extended Kalman filter's step."""
        value, H = (
            np.array(found)
            for found in self._residual(place, self._problem.known(sample), self._problem.measured(sample))
        )
        S = H @ self._P @ H.T + np.eye(len(H))
        gain = np.linalg.solve(S, H @ self._P).T
        self._mean = np.clip(self._mean - gain @ (value[:, 0] + H @ (self._mean - place)), 0.0, 1.0)
        left = np.eye(len(self._P)) - gain @ H
        self._P = left @ self._P @ left.T + gain @ gain.T + self._problem.settings.walk**2 * np.eye(len(self._P))


def imported_do_mpc() -> Any:
    """Return do-mpc; it warns of its optional parts when it is imported, and CasADi of how do-mpc calls NumPy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import casadi
        import do_mpc
    if hasattr(casadi.GlobalOptions, "setNumpyMode"):
        casadi.GlobalOptions.setNumpyMode(-1)
    return do_mpc


PEERS: dict[str, Callable[[Problem], Any]] = {"do-mpc": DoMpcHorizon, "casadi-ipopt": CasadiHorizon}
"""Estimators by name, each with step(sample) -> theta."""


# -- models in CasADi's symbols ------------------------------------------------------------------------------------


def pendulum(x: Sequence[Any], u: Sequence[Any], theta: Sequence[Any]) -> list[Any]:
    """Return the angular acceleration, as `fmu_models.pendulum` has it."""
    import casadi

    m, l = theta
    return [-9.81 / l * casadi.sin(x[0]) - 0.1 / m * x[1] + u[0] / (m * l)]


def quadrotor(x: Sequence[Any], u: Sequence[Any], theta: Sequence[Any]) -> list[Any]:
    """Return linear and angular accelerations, as `fmu_models.quadrotor` has them."""
    m, J_x, J_y, J_z = theta
    F, M_x, M_y, M_z = u[:4]
    p, q, r = x[15:18]
    return [
        -F / m * x[8], -F / m * x[11], 9.81 - F / m * x[14],
        (M_x - (J_z - J_y) * q * r) / J_x, (M_y - (J_x - J_z) * p * r) / J_y, (M_z - (J_y - J_x) * p * q) / J_z,
    ]  # fmt: skip
