/* Mass-spring-damper: m x'' = F - c x' - k x, classical Runge-Kutta steps of a thousandth of a second or less.

   c_limit: a step with more damping than that fails, as a solver would.
   -DSTIFFER: the spring is a hundredth stiffer than k says. */

#include <math.h>

#define N_VARIABLES 7
enum { M, C, K, F, X, V, C_LIMIT };

#ifdef STIFFER
#define STIFFNESS 1.01
#else
#define STIFFNESS 1.0
#endif

static const double start[N_VARIABLES] = {1.0, 0.5, 10.0, 0.0, 0.1, 0.0, 1e9};

static double acceleration(const double *value, double x, double v) {
    return (value[F] - value[C] * v - STIFFNESS * value[K] * x) / value[M];
}

static void refresh(double *value) {}

static int step(double *value, double t, double h) {
    int n = (int)ceil(h / 1e-3 - 1e-9);
    double d = h / n;
    if (value[C] > value[C_LIMIT]) return 0;
    for (int i = 0; i < n; i++) {
        double x = value[X], v = value[V];
        double v1 = v, a1 = acceleration(value, x, v1);
        double v2 = v + d / 2 * a1, a2 = acceleration(value, x + d / 2 * v1, v2);
        double v3 = v + d / 2 * a2, a3 = acceleration(value, x + d / 2 * v2, v3);
        double v4 = v + d * a3, a4 = acceleration(value, x + d * v3, v4);
        value[X] = x + d / 6 * (v1 + 2 * v2 + 2 * v3 + v4);
        value[V] = v + d / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
    }
    return 1;
}

#include "fmi_model.h"
