"""A mass, a spring and a damper whose state starts as two parameters, as Modelica's tools export it."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class StartParameters(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.m, self.c, self.k, self.F, self.x, self.v = 1.7, 0.9, 23.0, 0.0, 0.0, 0.0
        self.x_start, self.v_start = 0.1, 0.0
        for name in ("m", "c", "k", "x_start", "v_start"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(Real("F", causality=Fmi2Causality.input))
        for name in ("x", "v"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def exit_initialization_mode(self):
        self.x, self.v = self.x_start, self.v_start

    def do_step(self, t, h):
        for _ in range(10):  # symplectic Euler steps
            self.v += 0.1 * h * (self.F - self.c * self.v - self.k * self.x) / self.m
            self.x += 0.1 * h * self.v
        return True
