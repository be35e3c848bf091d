/* A drive as a Modelica tool would name it: J dw/dt = tau - d w. Exact for a torque that is held over a step. */

#include <math.h>

#define N_VARIABLES 6
enum { TAU, PHI, W, DER_W, J, D };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 0.0, 0.02, 0.05};

static void refresh(double *v) { v[DER_W] = (v[TAU] - v[D] * v[W]) / v[J]; }

static int step(double *v, double t, double h) {
    const double rate = v[D] / v[J], end = v[TAU] / v[D]; /* of the speed that the torque leads to */
    const double gap = v[W] - end, left = exp(-rate * h);
    v[PHI] += end * h + gap * (1.0 - left) / rate;
    v[W] = end + gap * left;
    return 1;
}

#include "fmi_model.h"
