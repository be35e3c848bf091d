"""The plant FMU of the rigid body."""

from pythonfmu import DefaultExperiment

from ..kernel import so3
from ..kernel.blocks import PlantSlave, StateVector
from ..kernel.description import disturbance, input_variable, parameter, state
from . import equations

J = ("J_xx", "J_yy", "J_zz", "J_xy", "J_xz", "J_yz")
C = ("c_x", "c_y", "c_z")
FORCES = tuple(f"{name}_{a}" for name in ("F", "M", "F_d", "M_d") for a in "xyz")
DRAG = ("k_d", "v_x", "v_y", "v_z")
ATTITUDE = tuple(f"R_{i}{j}" for i in "123" for j in "123")
OMEGA = ("Omega_x", "Omega_y", "Omega_z")
AXES = {"1": "x", "2": "y", "3": "z"}


class RigidBody(PlantSlave):
    """Free rigid body under a wrench at its origin; inertial z down, R takes body to inertial vectors."""

    default_experiment = DefaultExperiment(0.0, 10.0, 0.01)
    table = (
        parameter("m", "kg", 2.5, "Mass", min=0.5, max=8.0),
        *(parameter(f"c_{a}", "m", 0.0, f"Centre of mass from the origin, body {a}", min=-0.3, max=0.3) for a in "xyz"),
        *(
            parameter(f"J_{a}{a}", "kg.m2", s, f"Inertia about the centre of mass, body {a}", min=0.1, max=12.0)
            for a, s in zip("xyz", (0.3, 0.4, 0.5))
        ),
        *(
            parameter(f"J_{ab}", "kg.m2", 0.0, f"Element {ab} of the inertia's matrix", min=-2.0, max=2.0)
            for ab in ("xy", "xz", "yz")
        ),
        parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
        parameter("k_d", "kg/s", 0.0, "Linear drag, at the origin", min=0.0),
        *(
            input_variable(f"F_{a}", "N", s, f"Force at the origin, body {a}", nominal=10.0)
            for a, s in zip("xyz", (0.0, 0.0, -24.525))  # hover
        ),
        *(input_variable(f"M_{a}", "N.m", 0.0, f"Moment about the origin, body {a}") for a in "xyz"),
        *(disturbance(f"F_d_{a}", "N", f"Disturbance force at the origin, inertial {a}") for a in "xyz"),
        *(disturbance(f"M_d_{a}", "N.m", f"Disturbance moment about the origin, body {a}") for a in "xyz"),
        *(state(f"r_{a}", "m", 0.0, f"Position of the origin, inertial {a}", depends=[f"v_{a}"]) for a in "xyz"),
        *(
            state(
                f"v_{a}", "m/s", 0.0, f"Velocity of the origin, inertial {a}",
                depends=["m", *C, *J, *FORCES, *DRAG, *OMEGA, *ATTITUDE, *(["g"] if a == "z" else [])],
            ) for a in "xyz"
        ),
        *(
            state(
                f"R_{i}{j}", "1", float(i == j), f"Attitude, row {i}, column {j}",
                depends=[name for k, a in AXES.items() if k != j for name in (f"R_{i}{k}", f"Omega_{a}")],
            ) for i in "123" for j in "123"
        ),
        *(
            state(
                f"Omega_{a}", "rad/s", 0.0, f"Angular velocity, body {a}",
                depends=[*C, *J, *FORCES, *DRAG, *OMEGA, *ATTITUDE],
            ) for a in "xyz"
        ),
    )  # fmt: skip
    derivative = staticmethod(equations.derivative)

    @staticmethod
    def project(x: StateVector) -> StateVector:
        """Return the state with its attitude made orthogonal again."""
        return x[:6] + so3.orthonormalized(x[6:15]) + x[15:]
