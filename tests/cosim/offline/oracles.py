"""The plant's response in closed form, and logs made of it: no code of ours."""

import csv
from types import SimpleNamespace

import numpy as np

TRUTH = SimpleNamespace(m=1.7, c=0.9, k=23.0)
START = (0.1, 0.0)  # m, m/s: the FMU's own


def response(t, force, m=TRUTH.m, c=TRUTH.c, k=TRUTH.k, start=START):
    """x (n,) and v (n,) of m x'' + c x' + k x = F, F held from each t to the next; underdamped.

    Between two times x = F/k + exp(-a s) (A cos w s + B sin w s), a = c/2m, w = sqrt(k/m - a^2).
    """
    a = c / (2.0 * m)
    w = np.sqrt(k / m - a * a)
    x, v = [start[0]], [start[1]]
    for h, f in zip(np.diff(t), force, strict=False):
        A = x[-1] - f / k
        B = (v[-1] + a * A) / w
        decay, cos, sin = np.exp(-a * h), np.cos(w * h), np.sin(w * h)
        x.append(f / k + decay * (A * cos + B * sin))
        v.append(decay * ((B * w - a * A) * cos - (A * w + a * B) * sin))
    return np.array(x), np.array(v)


def pushes(t):
    """A force (n,) [N] that excites everything: two square waves."""
    return 3.0 * np.sign(np.sin(2.3 * t)) + 2.0 * np.sign(np.sin(0.7 * t + 0.4))


def measure(seed=0, noise=2e-3, end=8.0, h=0.01, force=pushes, **truth):
    """A log of the plant by column: time, force, and position and velocity with noise [m, m/s]."""
    rng = np.random.default_rng(seed)
    t = h * np.arange(round(end / h) + 1)
    u = force(t)
    x, v = response(t, u, **truth)
    return {
        "time [s]": t,
        "force [N]": u,
        "x [m]": x + noise * rng.standard_normal(len(t)),
        "v [m/s]": v + noise * rng.standard_normal(len(t)),
    }


def jump(seed=0, at=4.0, noise=2e-3, end=8.0, h=0.01, force=pushes, m=2.6, c=1.4, k=TRUTH.k):
    """Such a log of a plant whose parameters are others from t = at [s] on."""
    rng = np.random.default_rng(seed)
    t, n = h * np.arange(round(end / h) + 1), round(at / h)
    u = force(t)
    before = response(t[: n + 1], u)
    after = response(t[n:], u[n:], m, c, k, (before[0][-1], before[1][-1]))
    x, v = (np.concatenate([a[:-1], b]) for a, b in zip(before, after, strict=True))
    return {
        "time [s]": t,
        "force [N]": u,
        "x [m]": x + noise * rng.standard_normal(len(t)),
        "v [m/s]": v + noise * rng.standard_normal(len(t)),
    }


def write_log(path, columns):
    """The columns as CSV; NaN as an empty cell."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if v != v else repr(float(v)) for v in row])
    return path
