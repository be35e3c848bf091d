"""The reference FMU of the rigid body."""

from pythonfmu import DefaultExperiment

from ..kernel.blocks import ReferenceSlave, StateVector
from ..kernel.description import output, parameter
from . import equations

POSITION = (
    ("r_d", "m", "Desired position"),
    ("v_d", "m/s", "Desired velocity, the derivative of r_d"),
    ("a_d", "m/s2", "Desired acceleration, the second derivative of r_d"),
)
RATES = (
    ("Omega_d", "rad/s", "Desired angular velocity"),
    ("Omega_dot_d", "rad/s2", "Desired angular acceleration, the derivative of Omega_d"),
)
ANGLES = ("phi", "theta", "psi")
NEEDED = {"11": ANGLES[1:], "21": ANGLES[1:], "31": ANGLES[1:2], "32": ANGLES[:2], "33": ANGLES[:2]}


class RigidBodyReference(ReferenceSlave):
    """Desired motion of a rigid body, two tones in each coordinate, to the second derivative; starts at rest."""

    default_experiment = DefaultExperiment(0.0, 10.0, 0.01)
    table = (
        *(parameter(f"amplitude_{a}", "m", 0.5, f"Amplitude of position {a}", min=0.0) for a in "xyz"),
        parameter("amplitude_phi", "rad", 0.4, "Amplitude of the roll angle", min=0.0),
        parameter("amplitude_theta", "rad", 0.4, "Amplitude of the pitch angle", min=0.0),
        parameter("amplitude_psi", "rad", 0.6, "Amplitude of the yaw angle", min=0.0),
        parameter("omega", "rad/s", 1.5, "Base angular frequency", min=1e-3),
        *(
            output(f"{name}_{a}", unit, f"{text}, inertial {a}", depends=("time", f"amplitude_{a}", "omega"))
            for name, unit, text in POSITION
            for a in "xyz"
        ),
        *(
            output(
                f"R_d_{i}{j}", "1", f"Desired attitude, row {i}, column {j}",
                depends=("time", "omega", *(f"amplitude_{angle}" for angle in NEEDED.get(f"{i}{j}", ANGLES))),
            ) for i in "123" for j in "123"
        ),
        *(
            output(
                f"{name}_{a}", unit, f"{text}, body {a}",
                depends=("time", "omega", *(f"amplitude_{angle}" for angle in ANGLES)),
            ) for name, unit, text in RATES for a in "xyz"
        ),
    )  # fmt: skip

    def outputs(self, time: float, parameters: StateVector) -> StateVector:
        """Return position and derivatives, then attitude and derivatives."""
        d = equations.motion(time, parameters[0:3], parameters[3:6], parameters[6])
        return (*d.r, *d.v, *d.a, *d.R, *d.Omega, *d.Omega_dot)
