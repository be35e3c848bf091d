/* A ball that bounces, as that of Modelica's Reference-FMUs: h'' = a - g; at h = 0 the velocity turns and keeps the
   share e of its size, until it is below 0.1 m/s. In it events of every kind:

     h, the event indicator     a bounce, in two updates of the discrete states
     n_stairs                   counts seconds, at time events
     n_told                     counts step events: the first after each time that v has become negative in flight */

#define N_VARIABLES 13
#define N_STATES 2
#define N_INDICATORS 1
enum { A, H, V, DER_H, DER_V, G, E, N_BOUNCES, N_STAIRS, NEXT, N_TOLD, WAS_UP, IS_BOUNCING };

static const double start[N_VARIABLES] = {0.0, 1.0, 0.0, 0.0, 0.0, 9.81, 0.7, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0};
static const unsigned states[N_STATES] = {H, V}, rates[N_STATES] = {DER_H, DER_V};

static void refresh(double *v) {
    int is_at_rest = v[H] == 0.0 && v[V] == 0.0;
    v[DER_H] = v[V];
    v[DER_V] = is_at_rest ? 0.0 : v[A] - v[G];
}

static int step(double *v, double t, double h) { return 0; }

static void indicate(const double *v, double *z) { z[0] = v[H] == 0.0 && v[V] == 0.0 ? 1.0 : v[H]; }

static int is_step_event(const double *v) { return v[V] < 0.0 && v[WAS_UP]; }

static int event(double *v, double t, double *next) {
    int again = 0;
    if (is_step_event(v)) {
        v[N_TOLD] += 1.0;
        v[WAS_UP] = 0.0;
    }
    if (v[IS_BOUNCING]) {
        v[V] = fabs(v[V] * v[E]);
        if (v[V] < 0.1) v[V] = 0.0;
        v[WAS_UP] = v[V] > 0.0;
        v[IS_BOUNCING] = 0.0;
    } else if (v[H] <= 0.0 && v[V] < 0.0) {
        v[H] = 0.0;
        v[N_BOUNCES] += 1.0;
        v[IS_BOUNCING] = again = 1;
    }
    if (t == v[NEXT]) {
        v[N_STAIRS] += 1.0;
        v[NEXT] += 1.0;
    }
    *next = v[NEXT];
    return again;
}

#include "fmi_model.h"
