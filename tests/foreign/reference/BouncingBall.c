/* BouncingBall of Modelica's Reference-FMUs, by its equations: h'' = g; where the ball comes to the ground its velocity turns
   and keeps the share e; below 0.1 m/s it rests. Co-simulation: Euler's rule, and the event where a part of the step ends. */

#define N_VARIABLES 6
#define N_STATES 2
#define N_INDICATORS 1
enum { H, V, DER_H, DER_V, G, E };

static const double start[N_VARIABLES] = {1.0, 0.0, 0.0, -9.81, -9.81, 0.7};
static const unsigned states[N_STATES] = {H, V}, rates[N_STATES] = {DER_H, DER_V};

static void refresh(double *v) {
    v[DER_H] = v[V];
    v[DER_V] = v[G];
}
static void indicate(const double *v, double *z) { z[0] = v[H] == 0.0 && v[V] == 0.0 ? 1.0 : v[H]; }
static int is_step_event(const double *v) { return 0; }
static int event(double *v, double t, double *next) {
    if (v[H] <= 0.0) {
        v[H] = 0.0;
        v[V] = fabs(v[V] * v[E]);
        if (v[V] < 0.1) v[V] = v[G] = 0.0;
    }
    return 0;
}
static int step(double *v, double t, double h) {
    const int n = 10;
    double next;
    for (int i = 0; i < n; i++) {
        refresh(v);
        v[H] += h / n * v[DER_H];
        v[V] += h / n * v[DER_V];
        if (v[H] <= 0.0 && v[V] < 0.0) event(v, t, &next);
    }
    return 1;
}

#include "fmi_model.h"
