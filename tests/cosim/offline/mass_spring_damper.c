/* Mass-spring-damper, an FMI 2.0 co-simulation FMU that shares no code with the package.

   m x'' = F - c x' - k x, classical Runge-Kutta steps of a thousandth of a second or less.
   Value references: 0 m, 1 c, 2 k (parameters), 3 F (input), 4 x, 5 v (outputs, their start values settable),
   6 c_limit: a step with more damping than that fails, as a solver would.
   -DSTIFFER: the spring is a hundredth stiffer than k says. -DONCE: one instance a process, as some tools export. */

#include <math.h>
#include <stdlib.h>

#include "fmi2Functions.h"

#define N_VARIABLES 7
enum { M, C, K, F, X, V, C_LIMIT };

#ifdef STIFFER
#define STIFFNESS 1.01
#else
#define STIFFNESS 1.0
#endif

typedef struct {
    double value[N_VARIABLES];
} Plant;

static int n_instances;

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    static const double start[N_VARIABLES] = {1.0, 0.5, 10.0, 0.0, 0.1, 0.0, 1e9};
    Plant *p;
#ifdef ONCE
    if (n_instances++) return NULL;
#endif
    p = type == fmi2CoSimulation ? calloc(1, sizeof *p) : NULL;
    for (int i = 0; p && i < N_VARIABLES; i++) p->value[i] = start[i];
    return p;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2Error; } /* nobody may rely on it */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    const Plant *p = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= N_VARIABLES) return fmi2Error;
        value[i] = p->value[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Plant *p = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= N_VARIABLES) return fmi2Error;
        p->value[vr[i]] = value[i];
    }
    return fmi2OK;
}

static double acceleration(const double *value, double x, double v) {
    return (value[F] - value[C] * v - STIFFNESS * value[K] * x) / value[M];
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean forward_only) {
    double *value = ((Plant *)c)->value;
    int n = (int)ceil(h / 1e-3 - 1e-9);
    double d = h / n;
    if (value[C] > value[C_LIMIT]) return fmi2Error;
    for (int i = 0; i < n; i++) {
        double x = value[X], v = value[V];
        double v1 = v, a1 = acceleration(value, x, v1);
        double v2 = v + d / 2 * a1, a2 = acceleration(value, x + d / 2 * v1, v2);
        double v3 = v + d / 2 * a2, a3 = acceleration(value, x + d / 2 * v2, v3);
        double v4 = v + d * a3, a4 = acceleration(value, x + d * v3, v4);
        value[X] = x + d / 6 * (v1 + 2 * v2 + 2 * v3 + v4);
        value[V] = v + d / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
    }
    return fmi2OK;
}

/* Variables of the other types: there are none. */
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    return n ? fmi2Error : fmi2OK;
}

/* Neither states nor derivatives are offered. */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return fmi2Error; }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return fmi2Error; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { return fmi2Error; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) { return fmi2Error; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    return fmi2Error;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    return fmi2Error;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real known_seed[],
                                        fmi2Real unknown_seed[]) {
    return fmi2Error;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    return fmi2Error;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    return fmi2Error;
}
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) { return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) { return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { return fmi2Discard; }
