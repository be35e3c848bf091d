"""The reference trajectory of each plant, fmu_models/PLANT/reference.csv, in the manner of the Reference-FMUs.

python tests/fmu_models/reference_data.py      writes them all

A row has the time, the inputs, held from there to the next row, and the states; a plant starts as its FMU does.
The equations are written here once more, in vectors and matrices and from the laws of mechanics, and integrated by
SciPy's DOP853 with a relative tolerance of 1e-12; fmu_models has them solved and element by element, and its own
integrator.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Law = Callable[[float, Array], Array]
PACKAGE = Path(__file__).parents[2] / "fmu_models"
TIMES = np.linspace(0.0, 10.0, 51)
G = 9.81
integrate = partial(solve_ivp, method="DOP853", rtol=1e-12, atol=1e-13)


def pendulum(x: Array, u: Array) -> Array:
    """Newton's second law along the tangent, where the speed is l phi_dot."""
    m, l, b = 1.75, 0.75, 0.1
    return np.array([x[1], (u[0] - m * G * np.sin(x[0]) - b * l * x[1]) / (m * l)])


def quadrotor(x: Array, u: Array) -> Array:
    """Newton in the inertial frame, Euler in the body's, R_dot = R hat(Omega)."""
    m, J = 1.25, np.diag([1.1, 1.1, 2.2])
    v, R, Omega = x[3:6], x[6:15].reshape(3, 3), x[15:]
    a = np.array([0.0, 0.0, G]) - u[0] / m * R[:, 2]
    Omega_dot = np.linalg.solve(J, u[1:] - np.cross(Omega, J @ Omega))
    return np.concatenate([v, a, (R @ hat(Omega)).ravel(), Omega_dot])


C = np.array([0.1, -0.05, 0.08])
"""Centre of mass of the rigid body [m]: what the FMU starts with, zero, would hide most of the equations."""


def rigid_body(x: Array, u: Array) -> Array:
    """Newton and Euler about the origin, one system of six in the body's frame.

    [[m 1, -m hat(c)], [m hat(c), J_o]] (a, Omega_dot) = wrench - (m Omega x (Omega x c), Omega x J_o Omega), with
    J_o = J - m hat(c)^2. Featherstone (2008), eq. 2.63.
    """
    m, J = 2.5, np.diag([0.3, 0.4, 0.5])
    v, R, Omega = x[3:6], x[6:15].reshape(3, 3), x[15:]
    J_o = J - m * hat(C) @ hat(C)
    mass = np.block([[m * np.eye(3), -m * hat(C)], [m * hat(C), J_o]])
    centrifugal = np.concatenate([m * np.cross(Omega, np.cross(Omega, C)), np.cross(Omega, J_o @ Omega)])
    weight = R.T @ [0.0, 0.0, m * G]
    wrench = u + np.concatenate([weight, np.cross(C, weight)])
    a, Omega_dot = np.split(np.linalg.solve(mass, wrench - centrifugal), 2)
    return np.concatenate([v, R @ a, (R @ hat(Omega)).ravel(), Omega_dot])


def magnetic_levitation(x: Array, u: Array) -> Array:
    """Newton's second law along the vertical, downwards; the force goes with the square of current over gap."""
    m, z_0, k = 0.1, 0.004, 2e-4
    magnet = -k * u[0] ** 2 / (x[0] + z_0) ** 2
    return np.array([x[1], (m * G + magnet + u[1]) / m])


def hat(a: Array) -> Array:
    """Return the matrix with hat(a) b = a x b."""
    return np.cross(a, np.eye(3), axisb=0, axisc=0)


def smooth(f: Callable[[Array, Array], Array], x: Array, u: Array, duration: float) -> Array:
    """Return the state after the inputs have been held for the duration [s]."""
    return integrate(lambda _, x: f(x, u), (0.0, duration), x).y[:, -1]


def friction_pendulum(x: Array, u: Array, duration: float) -> Array:
    """Return the state after the duration [s]: slip, break-away and stick, each up to the event that ends it."""
    m, l, F_c, F_s, u_d, b, phi_dot_s, band, tau = 1.75, 0.75, 1.0, 0.8, 2.0, 0.1, 0.3, 0.01, 0.01
    actuated = np.sign(u[0]) * max(abs(u[0]) - u_d, 0.0)

    def driving(x: Array) -> float:
        return actuated - m * G * np.sin(x[0]) - b * l * x[1]

    def excess(_: float, x: Array) -> float:
        return abs(driving(x)) - (F_c + F_s)

    def moving(direction: float, level: Callable[[float], float]) -> Law:
        return lambda _, x: np.array([x[1], (driving(x) - direction * level(x[1])) / (m * l)])

    t = 0.0
    while duration - t > 1e-12:
        direction = np.sign(x[1] if abs(x[1]) > band else driving(x))
        at_the_edge = lambda _, x, s=direction: s * x[1] - band  # noqa: E731
        if abs(x[1]) > band:
            law, ends = moving(direction, lambda v: F_c + F_s * np.exp(-((v / phi_dot_s) ** 2))), [at_the_edge]
        elif excess(t, x) > 0.0:
            law, ends = moving(direction, lambda _: F_c + F_s), [at_the_edge, excess]
        else:
            law, ends = (lambda _, x: np.array([x[1], -x[1] / tau])), [excess]
        for end in ends:
            end.terminal = True
        solution = integrate(law, (t, duration), x, events=ends)
        t, x = solution.t[-1], solution.y[:, -1]
        if solution.status == 1:  # an event: go just beyond it
            x = x + 1e-12 * law(t, x)
    return x


@dataclass(frozen=True)
class Case:
    """A plant's reference trajectory."""

    advance: Callable[[Array, Array, float], Array]
    """State after inputs have been held for a time [s]."""
    inputs: dict[str, tuple[float, float]]
    """By name: mean and amplitude of a sinusoid, `rate` for the first and 0.4 rad/s more for each other."""
    states: dict[str, float]
    """Start values by name."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Those that are not what the FMU starts with."""
    times: Array = field(default_factory=lambda: TIMES)
    """Times of the rows [s]."""
    rate: float = 1.3
    """Angular frequency of the first input [rad/s]."""

    def rows(self) -> list[list[float]]:
        """Return time, inputs and states (n_times, 1 + n_inputs + n_states)."""
        x, (means, sizes) = np.array(list(self.states.values())), np.array(list(self.inputs.values())).T
        rates = self.rate + 0.4 * np.arange(len(sizes))
        u = [np.round(means + sizes * np.sin(rates * t), 3) for t in self.times]
        rows = [[self.times[0], *u[0], *x]]
        for (begin, end), held, new in zip(pairwise(self.times), u[:-1], u[1:], strict=True):
            x = self.advance(x, held, end - begin)
            rows.append([end, *new, *x])
        return rows


AXES = "xyz"
BODY = {
    **{f"{name}_{a}": 0.0 for name in ("r", "v") for a in AXES},
    **{f"R_{i}{j}": float(i == j) for i in "123" for j in "123"},
    **{f"Omega_{a}": 0.0 for a in AXES},
}
HOVER = [0.0, 0.0, -24.525]
CASES = {
    "pendulum": Case(partial(smooth, pendulum), {"u": (0.0, 5.0)}, {"phi": 0.5, "phi_dot": 0.0}),
    "magnetic_levitation": Case(  # unstable: after a fifth of a second a difference is a thousand times as large
        partial(smooth, magnetic_levitation),
        {"i": (0.9, 0.2), "F_d": (0.0, 0.1)},
        {"z": 0.01, "v": 0.0},
        times=np.linspace(0.0, 0.2, 21),
        rate=40.0,
    ),
    "friction_pendulum": Case(friction_pendulum, {"u": (0.0, 9.0)}, {"phi": 0.0, "phi_dot": 0.0}),
    "quadrotor": Case(
        partial(smooth, quadrotor),
        {"F": (12.263, 2.0), "M_x": (0.0, 0.3), "M_y": (0.0, 0.2), "M_z": (0.0, 0.4)},
        BODY,
    ),
    "rigid_body": Case(
        partial(smooth, rigid_body),
        {
            **{f"F_{a}": (mean, 2.0) for a, mean in zip(AXES, HOVER, strict=True)},
            **{f"M_{a}": (mean, 0.2) for a, mean in zip(AXES, np.cross(C, HOVER), strict=True)},
        },
        BODY,
        {f"c_{a}": float(c) for a, c in zip(AXES, C, strict=True)},
    ),
}


def main() -> None:
    """Write all of them."""
    for plant, case in CASES.items():
        with (PACKAGE / plant / "reference.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["time", *case.inputs, *case.states])
            writer.writerows([[f"{value:.15g}" for value in row] for row in case.rows()])


if __name__ == "__main__":
    main()
