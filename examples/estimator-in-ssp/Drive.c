/* A drive as a Modelica tool would name it: J dw/dt = tau - d w. Exact for a torque that is held over a step; the sensor
   of the motor says which. */

#include <math.h>

#define N_VARIABLES 7
enum { TAU, PHI, W, DER_W, J, D, HELD };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 0.0, 0.02, 0.05, 0.0};

static void refresh(double *v) {
    v[HELD] = v[TAU];
    v[DER_W] = (v[TAU] - v[D] * v[W]) / v[J];
}

static int step(double *v, double t, double h) {
    const double rate = v[D] / v[J], end = v[TAU] / v[D]; /* of the speed that the torque leads to */
    const double gap = v[W] - end, left = exp(-rate * h);
    v[PHI] += end * h + gap * (1.0 - left) / rate;
    v[W] = end + gap * left;
    return 1;
}

#include "fmi_model.h"
