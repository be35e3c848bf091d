/* A small model in C as an FMU of FMI 2.0 or, with -DFMI=3, of FMI 3.0: for co-simulation and, where it has states, for
   model exchange. The file that includes this at its end has defined

     N_VARIABLES                                     all of them real; value references are places in v
     static const double start[N_VARIABLES];         start values
     static void refresh(double *v);                 outputs and derivatives from states, inputs and parameters
     static int step(double *v, double t, double h); one communication step; 0 where it fails

   and, for model exchange, N_STATES with the places of the states and of their derivatives, in the order of
   ModelStructure:

     static const unsigned states[N_STATES], rates[N_STATES];

   and, for model exchange with events, N_INDICATORS, which may be 0:

     static void indicate(const double *v, double *z);           z changes its sign where there is a state event
     static int is_step_event(const double *v);                  after a step of the solver
     static int event(double *v, double t, double *next);        update of the discrete states; whether another is needed

   and, with -DDIRECTIONAL=FACTOR, for directional derivatives in FMI 3.0, those by parameters times the factor:

     static double partial(const double *v, unsigned unknown, unsigned known);

   In FMI 3.0 the value reference N_VARIABLES is the time. -DONCE: one instance a process, as some tools export.
   -DONLY_EXCHANGE: no co-simulation. -DTOLERANCE=PLACE: the tolerance that it is given is put there, -1 without one.
   -DEARLY: each step of FMI 3.0 returns in its middle. -DOVER: each asks to end the simulation.
   -DNEEDS_STOP: no FMI 2.0 without a stop time.
   -DNEEDS_EVENT_MODE: no co-simulation in FMI 3.0 without it. -DLOCKED=PLACE: from that place on, values are set before
   initialization and in event mode only.
   The headers of the standard are FMPy's (fmpy/c-code). */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef N_STATES
#define N_STATES 0
static const unsigned states[1], rates[1];
#endif

#ifndef N_INDICATORS
#define N_INDICATORS 0
static void indicate(const double *v, double *z) {}
static int is_step_event(const double *v) { return 0; }
static int event(double *v, double t, double *next) { return 0; }
#endif

typedef struct {
    double v[N_VARIABLES];
    double time;
    int is_exchange;
    int is_in_event_mode;
    int is_initialized;
} Model;

static Model *new_model(int is_exchange) {
    Model *m;
#ifdef ONCE
    static int n_instances;
    if (n_instances++) return NULL;
#endif
    m = calloc(1, sizeof *m);
    if (m) memcpy(m->v, start, sizeof start);
    if (m) m->is_exchange = m->is_in_event_mode = is_exchange;
    return m;
}

static void begin(Model *m, double from, int has_tolerance, double tolerance) {
    m->time = from;
#ifdef TOLERANCE
    m->v[TOLERANCE] = has_tolerance ? tolerance : -1.0;
#endif
}

static int read_values(Model *m, const unsigned place[], size_t n, double value[]) {
    if (m->is_exchange) refresh(m->v);
    for (size_t i = 0; i < n; i++) {
        if (place[i] > N_VARIABLES) return 0;
        value[i] = place[i] == N_VARIABLES ? m->time : m->v[place[i]];
    }
    return 1;
}

static int write_values(Model *m, const unsigned place[], size_t n, const double value[]) {
    for (size_t i = 0; i < n; i++) {
        if (place[i] >= N_VARIABLES) return 0;
        m->v[place[i]] = value[i];
    }
    return 1;
}

static int update_model(Model *m, double *next) {
    int again;
    *next = HUGE_VAL;
    again = event(m->v, m->time, next);
    refresh(m->v);
    return again;
}

static int step_model(Model *m, double t, double h) {
    m->time = t + h;
    if (!step(m->v, t, h)) return 0;
    refresh(m->v);
    return 1;
}

#if FMI == 3
#include "fmi3_model.h"
#else
#include "fmi2_model.h"
#endif
