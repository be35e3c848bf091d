/* Position control by a computed force: f = m (Kp e + Kd de/dt) + c s_ref, with the error's derivative filtered by 20 ms. */

#define N_VARIABLES 8
enum { S_REF, S_MEAS, F, M, KP, KD, X, C };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 2.0, 36.0, 10.0, 0.0, 40.0};
static const double T = 0.02;

static void refresh(double *v) {
    const double e = v[S_REF] - v[S_MEAS];
    v[F] = v[M] * (v[KP] * e + v[KD] * (e - v[X]) / T) + v[C] * v[S_REF];
}

static int step(double *v, double t, double h) {
    v[X] += h / T * (v[S_REF] - v[S_MEAS] - v[X]);
    return 1;
}

#include "fmi_model.h"
