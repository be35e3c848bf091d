/* The functions of FMI 3.0 over a Model: see fmi_model.h. Derivatives of its functions are not offered. */

#include "fmi3Functions.h"

#define ANSWER(is_well) ((is_well) ? fmi3OK : fmi3Error)

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    return N_STATES ? new_model(1) : NULL;
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean has_event_mode, fmi3Boolean may_return_early,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
#ifdef NEEDS_EVENT_MODE
    if (!has_event_mode) {
        log(environment, fmi3Error, "logStatusError", "Clocks need event mode.");
        return NULL;
    }
#endif
    Model *m = new_model(0);
    if (m) m->is_in_event_mode = has_event_mode;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    return fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 from, fmi3Boolean has_stop, fmi3Float64 stop) {
    begin(c, from, has_tolerance, tolerance);
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    refresh(((Model *)c)->v);
    ((Model *)c)->is_initialized = 1;
    return fmi3OK;
}
fmi3Status fmi3EnterEventMode(fmi3Instance c) {
    ((Model *)c)->is_in_event_mode = 1;
    return fmi3OK;
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *is_over, fmi3Boolean *nominals,
                                    fmi3Boolean *states_changed, fmi3Boolean *has_next, fmi3Float64 *next) {
    *is_over = *nominals = fmi3False;
    *states_changed = fmi3True;
    if (!((Model *)c)->is_in_event_mode) return fmi3Error;
    *again = update_model(c, next);
    *has_next = *next < HUGE_VAL;
    return fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { return fmi3Error; } /* nobody may rely on it */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t size) {
    return ANSWER(size == n && read_values(c, vr, n, value));
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                          size_t size) {
#ifdef LOCKED
    const Model *m = c;
    for (size_t i = 0; i < n; i++)
        if (vr[i] >= LOCKED && m->is_initialized && !m->is_in_event_mode) return fmi3Error;
#endif
    return ANSWER(size == n && write_values(c, vr, n, value));
}

/* Co-simulation */

fmi3Status fmi3EnterStepMode(fmi3Instance c) {
    ((Model *)c)->is_in_event_mode = 0;
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keeps_no_state, fmi3Boolean *has_event,
                      fmi3Boolean *is_over, fmi3Boolean *is_early, fmi3Float64 *last) {
    *has_event = is_step_event(((Model *)c)->v);
    *is_over = *is_early = fmi3False;
    if (((Model *)c)->is_in_event_mode) return fmi3Error;
    *last = t + h;
#ifdef EARLY
    *is_early = fmi3True;
    *last = t + h / 2;
#endif
#ifdef OVER
    *is_over = fmi3True;
#endif
    return ANSWER(step_model(c, t, h));
}

/* Model exchange */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    ((Model *)c)->is_in_event_mode = 0;
    return fmi3OK;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean keeps_no_state, fmi3Boolean *has_event,
                                       fmi3Boolean *is_over) {
    *has_event = is_step_event(((Model *)c)->v);
    *is_over = fmi3False;
    return fmi3OK;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) {
    ((Model *)c)->time = t;
    return fmi3OK;
}
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    return ANSWER(n == N_STATES && write_values(c, states, n, x));
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return ANSWER(n == N_STATES && read_values(c, states, n, x));
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 xdot[], size_t n) {
    return ANSWER(n == N_STATES && read_values(c, rates, n, xdot));
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominal[], size_t n) {
    for (size_t i = 0; i < n; i++) nominal[i] = 1.0;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    *n = N_STATES;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    *n = N_INDICATORS;
    return fmi3OK;
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) {
    indicate(((Model *)c)->v, z);
    return ANSWER(n == N_INDICATORS);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t n_unknown,
                                        const fmi3ValueReference known[], size_t n_known, const fmi3Float64 seed[],
                                        size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity) {
    if (n_unknown != n_sensitivity || n_known != n_seed) return fmi3Error;
#ifdef DIRECTIONAL
    refresh(((Model *)c)->v);
    for (size_t i = 0; i < n_unknown; i++) {
        sensitivity[i] = 0.0;
        for (size_t k = 0; k < n_known; k++) sensitivity[i] += seed[k] * partial(((Model *)c)->v, unknown[i], known[k]);
    }
    return fmi3OK;
#else
    return fmi3Error;
#endif
}

/* A state is a copy of the model: it has no pointers. */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi3Error;
    memcpy(*state, c, sizeof(Model));
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    memcpy(c, state, sizeof(Model));
    return fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    free(*state);
    *state = NULL;
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    *size = sizeof(Model);
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    if (size < sizeof(Model)) return fmi3Error;
    memcpy(bytes, state, sizeof(Model));
    return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    if (size != sizeof(Model)) return fmi3Error;
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi3Error;
    memcpy(*state, bytes, size);
    return fmi3OK;
}
