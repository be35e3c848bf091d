/* Oscillator, an FMU for co-simulation: what a step costs where the model costs nothing.

   x'' = -k x - c x' + u, one semi-implicit Euler step a communication step; k = 4 1/s2 and c = 0.5 1/s are constants. */

#define N_VARIABLES 4
enum { U, X, V, A };

static const double stiffness = 4.0, damping = 0.5;
static const double start[N_VARIABLES] = {0.0, 1.0, 0.0, -4.0};

static void refresh(double *v) {}

static int step(double *v, double t, double h) {
    v[A] = -stiffness * v[X] - damping * v[V] + v[U];
    v[V] += h * v[A];
    v[X] += h * v[V];
    return 1;
}

#include "fmi_model.h"
