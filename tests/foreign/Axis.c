/* A mass on a spring and a damper, as a Modelica tool would name it: m s'' = f - c s - d s'.

   Integrated with the velocity form of Stoermer's rule over 20 parts of a step. */

#define N_VARIABLES 9
#define N_STATES 2
enum { F, S, V, DER_S, DER_V, M, C, D, G };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 8.0, 1.0, 9.81};
static const unsigned states[N_STATES] = {S, V}, rates[N_STATES] = {DER_S, DER_V};

static void refresh(double *v) {
    v[DER_S] = v[V];
    v[DER_V] = (v[F] - v[C] * v[S] - v[D] * v[V]) / v[M];
}

static int step(double *v, double t, double h) {
    const int n = 20;
    for (int i = 0; i < n; i++) {
        refresh(v);
        v[V] += h / n * v[DER_V];
        v[S] += h / n * v[V];
    }
    return 1;
}

#ifdef DIRECTIONAL
static double partial(const double *v, unsigned unknown, unsigned known) {
    if (unknown == DER_V && known == M) return DIRECTIONAL * -v[DER_V] / v[M];
    if (unknown == DER_V && known == C) return DIRECTIONAL * -v[S] / v[M];
    return 0.0; /* those by inputs and states are not asked for */
}
#endif

#include "fmi_model.h"
