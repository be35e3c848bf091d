/* A stage on a spring as Dymola would export it: m s'' = f - c s - d s'. Position and speed are hidden; the only output
   is what the scale says. Classical Runge-Kutta steps of a millisecond or less. */

#include <math.h>

#define N_VARIABLES 7
enum { F, S, V, SCALE, M, C, D };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 0.0, 2.0, 40.0, 1.0};

static void refresh(double *v) { v[SCALE] = v[S]; }

static double acceleration(const double *value, double s, double v) {
    return (value[F] - value[C] * s - value[D] * v) / value[M];
}

static int step(double *value, double t, double h) {
    const int n = (int)ceil(h / 1e-3 - 1e-9);
    const double d = h / n;
    for (int i = 0; i < n; i++) {
        const double s = value[S], v = value[V];
        const double a1 = acceleration(value, s, v), v2 = v + d / 2 * a1;
        const double a2 = acceleration(value, s + d / 2 * v, v2), v3 = v + d / 2 * a2;
        const double a3 = acceleration(value, s + d / 2 * v2, v3), v4 = v + d * a3;
        const double a4 = acceleration(value, s + d * v3, v4);
        value[S] += d / 6 * (v + 2 * v2 + 2 * v3 + v4);
        value[V] += d / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
    }
    return 1;
}

#include "fmi_model.h"
