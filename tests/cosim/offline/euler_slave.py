"""A mass, a spring and a damper by explicit Euler steps, one a communication step."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class EulerPlant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.m, self.c, self.k, self.F, self.x, self.v = 1.7, 1.0, 20.0, 0.0, 0.1, 0.0
        for name in ("m", "c", "k"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(Real("F", causality=Fmi2Causality.input))
        for name in ("x", "v"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, t, h):
        acceleration = (self.F - self.c * self.v - self.k * self.x) / self.m
        self.x, self.v = self.x + h * self.v, self.v + h * acceleration
        return True
