"""Entry script of a pythonfmu FMU: the model of oscillator.c, written as pythonfmu's own examples are."""

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Real

STIFFNESS, DAMPING = 4.0, 0.5  # 1/s2, 1/s


class Oscillator(Fmi2Slave):
    """x'' = -k x - c x' + u, one semi-implicit Euler step a communication step."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.x, self.v, self.a = 0.0, 1.0, 0.0, -STIFFNESS
        self.register_variable(Real("u", causality=Fmi2Causality.input, start=0.0))
        for name in ("x", "v", "a"):
            self.register_variable(Real(name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact))

    def do_step(self, current_time, step_size):
        self.a = -STIFFNESS * self.x - DAMPING * self.v + self.u
        self.v += step_size * self.a
        self.x += step_size * self.v
        return True
