"""A heated barrel, and what melts in it: the melt's temperature is a slow state that acts on the barrel's."""

from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real


class SlowState(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.G, self.P, self.T, self.Tm, self.energy = 6.0, 0.0, 180.0, 178.0, 0.0
        self.register_variable(Real("G", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("P", causality=Fmi2Causality.input))
        for name in ("T", "Tm", "energy"):
            self.register_variable(Real(name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact))

    def do_step(self, t, h):
        for _ in range(4):
            flow = 12.0 * (self.T - self.Tm)
            self.T += h / 4 * (self.P - self.G * (self.T - 25.0) - flow) / 8000.0
            self.Tm += h / 4 * (flow - (self.Tm - 25.0)) / 3000.0
            self.energy += h / 4 * self.P
        return True
