"""Feedthrough and Resource of Modelica's Reference-FMUs in one, by their rules, FMI 2.0: outputs are inputs, and
y is the first character of a file."""

from pathlib import Path

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real


class Feedthrough2(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.real_in = self.real_out = 0.0
        self.int_in = self.int_out = 0
        self.bool_in = self.bool_out = False
        self.y = 0
        discrete = Fmi2Variability.discrete
        for name, kind, variability in (("real", Real, None), ("int", Integer, discrete), ("bool", Boolean, discrete)):
            self.register_variable(kind(f"{name}_in", causality=Fmi2Causality.input, variability=variability))
            self.register_variable(kind(f"{name}_out", causality=Fmi2Causality.output, variability=variability))
        self.register_variable(Integer("y", causality=Fmi2Causality.output, variability=discrete))

    def exit_initialization_mode(self):
        self.y = ord((Path(self.resources) / "y.txt").read_text()[0])

    def do_step(self, current_time, step_size):
        self.real_out, self.int_out, self.bool_out = self.real_in, self.int_in, self.bool_in
        return True
