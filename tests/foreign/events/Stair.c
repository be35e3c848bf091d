/* A stair that goes up each 0.1 s, at events that it announces and that no step may pass. */

#define N_VARIABLES 3
enum { COUNT, NEXT, PERIOD };

static const double start[N_VARIABLES] = {0.0, 0.1, 0.1};

#define N_INDICATORS 0
static void indicate(const double *v, double *z) {}
static int is_step_event(const double *v) { return 0; }
static void refresh(double *v) {}
static int step(double *v, double t, double h) { return t + h < v[NEXT] + 1e-9; }

static int event(double *v, double t, double *next) {
    if (t > v[NEXT] - 1e-9) {
        v[COUNT] += 1.0;
        v[NEXT] += v[PERIOD];
    }
    *next = v[NEXT];
    return 0;
}

#include "fmi_model.h"
