/* Stair of Modelica's Reference-FMUs, by its rule: a counter that begins at 1 and goes up each second, at time events. In
   co-simulation without event mode it goes up in the step that comes to the second. */

#define N_VARIABLES 3
#define N_STATES 1
#define N_INDICATORS 0
enum { COUNTER, X, DER_X };

static const double start[N_VARIABLES] = {1.0, 0.0, 0.0};
static const unsigned states[N_STATES] = {X}, rates[N_STATES] = {DER_X}; /* one that stays 0: solvers want one */

static void refresh(double *v) {}
static void indicate(const double *v, double *z) {}
static int is_step_event(const double *v) { return 0; }
static int event(double *v, double t, double *next) {
    if (t > v[COUNTER] - 1e-9) v[COUNTER] += 1.0;
    *next = v[COUNTER];
    return 0;
}
static int step(double *v, double t, double h) {
    double next;
    event(v, t + h, &next);
    return 1;
}

#include "fmi_model.h"
