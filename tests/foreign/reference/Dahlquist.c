/* Dahlquist of Modelica's Reference-FMUs, by its equation: x' = -k x. Co-simulation: Euler's rule. */

#define N_VARIABLES 3
#define N_STATES 1
enum { X, DER_X, K };

static const double start[N_VARIABLES] = {1.0, -1.0, 1.0};
static const unsigned states[N_STATES] = {X}, rates[N_STATES] = {DER_X};

static void refresh(double *v) { v[DER_X] = -v[K] * v[X]; }
static int step(double *v, double t, double h) {
    refresh(v);
    v[X] += h * v[DER_X];
    return 1;
}

#include "fmi_model.h"
