"""The reference FMU of magnetic levitation."""

from pythonfmu import DefaultExperiment

from ..kernel import references
from ..kernel.blocks import ReferenceSlave, StateVector
from ..kernel.description import output, parameter

NEEDED = ("time", "amplitude", "omega")


class MagneticLevitationReference(ReferenceSlave):
    """Desired gap, a sinusoid about a mean, to its second derivative."""

    default_experiment = DefaultExperiment(0.0, 3.0, 0.001)
    table = (
        parameter("mean", "m", 0.01, "Mean gap", min=0.0),
        parameter("amplitude", "m", 0.002, "Amplitude of the sinusoid"),
        parameter("omega", "rad/s", 25.0, "Angular frequency of the sinusoid", min=0.0),
        output("z_ref", "m", "Desired gap", depends=("mean", *NEEDED), nominal=0.01),
        output("v_ref", "m/s", "Desired velocity, the derivative of z_ref", depends=NEEDED, nominal=0.1),
        output("v_dot_ref", "m/s2", "Desired acceleration, the derivative of v_ref", depends=NEEDED),
    )

    def outputs(self, time: float, parameters: StateVector) -> StateVector:
        """Return gap, velocity and acceleration."""
        mean, amplitude, omega = parameters
        wave = references.sinusoid(time, amplitude, omega)
        return (mean + wave[0], wave[1], wave[2])
