"""The log `zone.csv`, by SciPy, not by the FMU: two days of a room of 5 MJ/K behind 0.006 K/W, the sensor 0.05 K."""

import numpy as np
from scipy.integrate import solve_ivp

C, R, STEP = 5e6, 0.006, 300.0  # J/K, K/W, s
t = STEP * np.arange(577)
outside = 276.15 + 5.0 * np.sin(2.0 * np.pi * (t / 86400.0 - 0.3))
heat = np.where((t / 3600.0) % 24.0 < 6.0, 500.0, np.where((t / 3600.0) % 3.0 < 1.5, 4000.0, 1500.0))
room = [291.15]
for k in range(len(t) - 1):
    found = solve_ivp(
        lambda _, T, k=k: ((outside[k] - T) / R + heat[k]) / C, (0.0, STEP), room[-1:], "DOP853", rtol=1e-10, atol=1e-10
    )
    room.append(float(found.y[0, -1]))
measured = np.array(room) - 273.15 + 0.05 * np.random.default_rng(0).standard_normal(len(t))
rows = np.column_stack([t, outside - 273.15, heat / 1000.0, measured])
header = "time [s],outside [degC],heat [kW],room [degC]"
np.savetxt("zone.csv", rows, "%.6g", ",", header=header, comments="")
