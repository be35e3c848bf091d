/* A PI controller in Modelica's form: y = k (e + x), dx/dt = e/Ti. */

#define N_VARIABLES 6
enum { W_REF, W_MEAS, TAU, K, TI, X };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 0.59, 0.07375, 0.0};

static void refresh(double *v) { v[TAU] = v[K] * (v[W_REF] - v[W_MEAS] + v[X]); }

static int step(double *v, double t, double h) {
    v[X] += h * (v[W_REF] - v[W_MEAS]) / v[TI];
    return 1;
}

#include "fmi_model.h"
