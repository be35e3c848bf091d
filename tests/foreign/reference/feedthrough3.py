"""Feedthrough and Resource of Modelica's Reference-FMUs in one, by their rules, FMI 3.0: outputs are inputs, and
y is the first character of a file."""

from pathlib import Path

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability, Int32


class Feedthrough3(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.real_in = self.real_out = 0.0
        self.int_in = self.int_out = 0
        self.bool_in = self.bool_out = False
        self.y = 0
        self.time = 0.0
        independent, continuous = Fmi3Causality.independent, Fmi3Variability.continuous
        self.register_variable(Float64("time", causality=independent, variability=continuous))
        discrete = Fmi3Variability.discrete
        for name, kind, variability in (("real", Float64, None), ("int", Int32, discrete), ("bool", Boolean, discrete)):
            self.register_variable(kind(f"{name}_in", causality=Fmi3Causality.input, variability=variability))
            self.register_variable(kind(f"{name}_out", causality=Fmi3Causality.output, variability=variability))
        self.register_variable(Int32("y", causality=Fmi3Causality.output, variability=discrete))

    def exit_initialization_mode(self):
        self.y = ord((Path(self.resources) / "y.txt").read_text()[0])

    def do_step(self, current_time, step_size):
        self.real_out, self.int_out, self.bool_out = self.real_in, self.int_in, self.bool_in
        return True
