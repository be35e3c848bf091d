"""A mass on a spring whose other end moves, by SciPy's RK45 with a loose tolerance: its step sizes depend on all."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real
from scipy.integrate import RK45


class AdaptivePlant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.m, self.c, self.k, self.x = 1.0, 1.0, 20.0, 0.1
        self.solver = None
        for name in ("m", "c", "k"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(Real("x", causality=Fmi2Causality.output))

    def slope(self, t, y):
        moved = 0.3 if t % 1.3 < 0.6 else -0.2
        return [y[1], -self.c / self.m * y[1] - self.k / self.m * (y[0] - moved)]

    def do_step(self, t, h):
        if self.solver is None:
            self.solver = RK45(self.slope, t, [self.x, 0.0], float("inf"), rtol=1e-5, atol=1e-7)
        while self.solver.t < t + h:
            self.solver.step()
        self.x = float(self.solver.dense_output()(t + h)[0])
        return True
