/* The functions of FMI 2.0 over a Model: see fmi_model.h. Derivatives of inputs are not offered. */

#include "fmi2Functions.h"

#define ANSWER(is_well) ((is_well) ? fmi2OK : fmi2Error)

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
#ifdef ONLY_EXCHANGE
    if (type == fmi2CoSimulation) return NULL;
#endif
    return type == fmi2CoSimulation || N_STATES ? new_model(type == fmi2ModelExchange) : NULL;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real from,
                               fmi2Boolean has_stop, fmi2Real stop) {
#ifdef NEEDS_STOP
    if (!has_stop) return fmi2Error;
#endif
    begin(c, from, has_tolerance, tolerance);
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    refresh(((Model *)c)->v);
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2Error; } /* nobody may rely on it */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    return ANSWER(read_values(c, vr, n, value));
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    return ANSWER(write_values(c, vr, n, value));
}

/* Variables of the other types: there are none. */
#define NONE_OF(Type)                                                                                          \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Type value[]) {   \
        return ANSWER(n == 0);                                                                                 \
    }                                                                                                          \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##Type value[]) { \
        return ANSWER(n == 0);                                                                                 \
    }
NONE_OF(Integer)
NONE_OF(Boolean)
NONE_OF(String)

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean forward_only) {
    return ANSWER(step_model(c, t, h));
}
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
#define NO_STATUS(Function, Type) \
    fmi2Status fmi2Get##Function(fmi2Component c, const fmi2StatusKind kind, Type *value) { return fmi2Discard; }
NO_STATUS(Status, fmi2Status)
NO_STATUS(RealStatus, fmi2Real)
NO_STATUS(IntegerStatus, fmi2Integer)
NO_STATUS(BooleanStatus, fmi2Boolean)
NO_STATUS(StringStatus, fmi2String)
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    return fmi2Error;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    return fmi2Error;
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    ((Model *)c)->is_in_event_mode = 1;
    return fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    memset(info, 0, sizeof *info);
    if (!((Model *)c)->is_in_event_mode) return fmi2Error;
    info->newDiscreteStatesNeeded = update_model(c, &info->nextEventTime);
    info->nextEventTimeDefined = info->nextEventTime < HUGE_VAL;
    info->valuesOfContinuousStatesChanged = fmi2True;
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    ((Model *)c)->is_in_event_mode = 0;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean keeps_no_state, fmi2Boolean *has_event,
                                       fmi2Boolean *is_over) {
    *has_event = is_step_event(((Model *)c)->v);
    *is_over = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) {
    ((Model *)c)->time = t;
    return fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    return ANSWER(n == N_STATES && write_values(c, states, n, x));
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return ANSWER(n == N_STATES && read_values(c, states, n, x));
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real xdot[], size_t n) {
    return ANSWER(n == N_STATES && read_values(c, rates, n, xdot));
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t n) {
    for (size_t i = 0; i < n; i++) nominal[i] = 1.0;
    return fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    indicate(((Model *)c)->v, z);
    return ANSWER(n == N_INDICATORS);
}

/* A state is a copy of the model: it has no pointers. */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi2Error;
    memcpy(*state, c, sizeof(Model));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    memcpy(c, state, sizeof(Model));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    *size = sizeof(Model);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (size < sizeof(Model)) return fmi2Error;
    memcpy(bytes, state, sizeof(Model));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    if (size != sizeof(Model)) return fmi2Error;
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi2Error;
    memcpy(*state, bytes, size);
    return fmi2OK;
}

/* What is not offered */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real known_seed[],
                                        fmi2Real unknown_seed[]) {
    return fmi2Error;
}
