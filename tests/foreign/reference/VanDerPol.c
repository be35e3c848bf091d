/* VanDerPol of Modelica's Reference-FMUs, by its equations: x'' = mu (1 - x x) x' - x. Co-simulation: Euler's rule. */

#define N_VARIABLES 5
#define N_STATES 2
enum { X0, X1, DER_X0, DER_X1, MU };

static const double start[N_VARIABLES] = {2.0, 0.0, 0.0, -2.0, 1.0};
static const unsigned states[N_STATES] = {X0, X1}, rates[N_STATES] = {DER_X0, DER_X1};

static void refresh(double *v) {
    v[DER_X0] = v[X1];
    v[DER_X1] = v[MU] * (1.0 - v[X0] * v[X0]) * v[X1] - v[X0];
}
static int step(double *v, double t, double h) {
    const int n = 10;
    for (int i = 0; i < n; i++) {
        refresh(v);
        v[X0] += h / n * v[DER_X0];
        v[X1] += h / n * v[DER_X1];
    }
    return 1;
}

#include "fmi_model.h"
