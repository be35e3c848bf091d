/* Set points of a speed: every second to the other of two, in a ramp of 0.2 s. */

#include <math.h>

#define N_VARIABLES 1
enum { W_REF };

static const double start[N_VARIABLES] = {0.0};

static void refresh(double *v) {}

static int step(double *v, double t, double h) {
    const double now = t + h, phase = now - floor(now), up = fmod(floor(now), 2.0);
    const double share = phase < 0.2 ? phase / 0.2 : 1.0;
    v[W_REF] = 50.0 * (up > 0.5 ? share : 1.0 - share) * (now >= 1.0);
    return 1;
}

#include "fmi_model.h"
