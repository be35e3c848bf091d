"""The plant FMU of the quadrotor."""

from pythonfmu import DefaultExperiment

from ..kernel import so3
from ..kernel.blocks import PlantSlave, StateVector
from ..kernel.description import disturbance, input_variable, parameter, state
from . import equations

J = ("J_x", "J_y", "J_z")
AXES = {"1": "x", "2": "y", "3": "z"}
THRUST = {"x": ("R_13",), "y": ("R_23",), "z": ("R_33", "g")}


class Quadrotor(PlantSlave):
    """Quadrotor on SE(3); inertial and body axes with z down, R takes body to inertial vectors."""

    default_experiment = DefaultExperiment(0.0, 16.0, 0.01)
    table = (
        parameter("m", "kg", 1.25, "Mass", min=0.5, max=4.0),
        parameter("J_x", "kg.m2", 1.1, "Inertia, body x", min=0.1, max=12.0),
        parameter("J_y", "kg.m2", 1.1, "Inertia, body y", min=0.1, max=12.0),
        parameter("J_z", "kg.m2", 2.2, "Inertia, body z", min=0.1, max=12.0),
        parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
        parameter("k_d", "kg/s", 0.0, "Linear drag", min=0.0),
        input_variable("F", "N", 12.2625, "Thrust along -z of the body; starts at hover", nominal=10.0),
        *(input_variable(f"M_{a}", "N.m", 0.0, f"Moment, body {a}") for a in "xyz"),
        *(disturbance(f"F_d_{a}", "N", f"Disturbance force, inertial {a}") for a in "xyz"),
        *(disturbance(f"M_d_{a}", "N.m", f"Disturbance moment, body {a}") for a in "xyz"),
        *(state(f"r_{a}", "m", 0.0, f"Position, inertial {a}", depends=[f"v_{a}"]) for a in "xyz"),
        *(
            state(
                f"v_{a}", "m/s", 0.0, f"Velocity, inertial {a}",
                depends=["m", "k_d", "F", f"F_d_{a}", f"v_{a}", *THRUST[a]],
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
                depends=[*J, f"M_{a}", f"M_d_{a}", *(f"Omega_{b}" for b in "xyz" if b != a)],
            ) for a in "xyz"
        ),
    )  # fmt: skip
    derivative = staticmethod(equations.derivative)

    @staticmethod
    def project(x: StateVector) -> StateVector:
        """Return the state with its attitude made orthogonal again."""
        return x[:6] + so3.orthonormalized(x[6:15]) + x[15:]
