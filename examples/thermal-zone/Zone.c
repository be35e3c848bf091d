/* A heated room as one heat capacity behind one resistance: C dT/dt = (T_out - T)/R + Q. Exact for inputs that are held
   over a step. */

#include <math.h>

#define N_VARIABLES 5
enum { T_OUT, Q, T, C, R };

static const double start[N_VARIABLES] = {273.15, 0.0, 293.15, 2e6, 0.01};

static void refresh(double *v) {}

static int step(double *v, double t, double h) {
    const double end = v[T_OUT] + v[R] * v[Q];
    v[T] = end + (v[T] - end) * exp(-h / (v[R] * v[C]));
    return 1;
}

#include "fmi_model.h"
