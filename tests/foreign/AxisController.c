/* Computed force for a mass on a spring: f = m (Kp (s_ref - s) + Kd (v_ref - v)) + c s + d v. */

#define N_VARIABLES 10
enum { S_MEAS, V_MEAS, S_REF, V_REF, F_CMD, M, C, D, KP, KD };

static const double start[N_VARIABLES] = {0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 8.0, 1.0, 25.0, 10.0};

static void refresh(double *v) {
    v[F_CMD] = v[M] * (v[KP] * (v[S_REF] - v[S_MEAS]) + v[KD] * (v[V_REF] - v[V_MEAS])) + v[C] * v[S_MEAS] +
               v[D] * v[V_MEAS];
}

static int step(double *v, double t, double h) { return 1; }

#include "fmi_model.h"
