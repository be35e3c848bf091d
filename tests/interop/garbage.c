/* An importer that fills every result with garbage before each call, and names those that a call which returned OK has
   left as they were: garbage cs2|cs3|me3 LIBRARY TOKEN RESOURCES TYPE REFERENCE [TYPE REFERENCE]...

   The variables are scalars: Real, Integer, Boolean, String of FMI 2.0, or a type of FMI 3.0. Calls every function that
   has a result, through initialisation, three steps, and the state's round trip. Exit codes: 0 done, 2 no library, 3 no
   instance, 4 a call that did not return OK, 5 the discrete states' update has no end. */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GARBAGE = 0xA5, MOST_STATES = 64, MOST_UPDATES = 100 };
typedef void *Instance;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished, *environment;
} Callbacks;
typedef struct {
    const char *type;
    unsigned reference;
} Variable;

static void *library;
static Instance instance;

static void logger2(void *e, const char *instance, int status, const char *category, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}
static void logger3(void *e, int status, const char *category, const char *message) {
    fprintf(stderr, "%s\n", message);
}

static void *function(const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "no function %s\n", name);
        exit(2);
    }
    return found;
}
#define CALL(name, types, ...) must(name, ((int(*) types)function(name))(__VA_ARGS__))
static void must(const char *name, int status) {
    if (status) {
        fprintf(stderr, "%s returned %d\n", name, status);
        exit(4);
    }
}

static void fill(void *result, size_t size) { memset(result, GARBAGE, size); }
static void written(const char *name, const char *argument, const void *result, size_t size) {
    const unsigned char *byte = result;
    for (size_t i = 0; i < size; i++)
        if (byte[i] != GARBAGE) return;
    printf("%s %s\n", name, argument);
}
#define FILL(x) fill(&(x), sizeof(x))
#define WRITTEN(name, x) written(name, #x, &(x), sizeof(x))

static void get2(Variable v) {
    char name[64];
    union { double real; int whole; const char *text; } values;
    const size_t size = !strcmp(v.type, "Real") ? sizeof values.real : sizeof values.whole;
    snprintf(name, sizeof name, "fmi2Get%s", v.type);
    FILL(values);
    CALL(name, (Instance, const unsigned *, size_t, void *), instance, &v.reference, 1, &values);
    written(name, "value", &values, !strcmp(v.type, "String") ? sizeof values.text : size);
}

static void get3(Variable v) {
    char name[64];
    union { double real; long long whole; const char *text; } values;
    snprintf(name, sizeof name, "fmi3Get%s", v.type);
    FILL(values);
    CALL(name, (Instance, const unsigned *, size_t, void *, size_t), instance, &v.reference, 1, &values, 1);
    written(name, "values", &values, sizeof values);  // one byte, that of a Boolean, is enough
}

static void round_trip(const char *get, const char *count, const char *write, const char *read, const char *set,
                       const char *release) {
    void *state = NULL, *again = NULL;  // the standard demands NULL, or a state
    size_t size;
    CALL(get, (Instance, void **), instance, &state);
    if (!state) printf("%s state\n", get);
    FILL(size);
    CALL(count, (Instance, void *, size_t *), instance, state, &size);
    WRITTEN(count, size);
    unsigned char *bytes = malloc(size);
    fill(bytes, size);
    CALL(write, (Instance, void *, void *, size_t), instance, state, bytes, size);
    written(write, "bytes", bytes, size);
    CALL(read, (Instance, const void *, size_t, void **), instance, bytes, size, &again);
    if (!again) printf("%s state\n", read);
    CALL(set, (Instance, void *), instance, again);
    CALL(release, (Instance, void **), instance, &state);
    CALL(release, (Instance, void **), instance, &again);
    free(bytes);
}

static void run_cs2(const char *token, const char *resources, const Variable *variables, int n) {
    static const Callbacks callbacks = {logger2, calloc, free, NULL, NULL};
    Instance (*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
    *(void **)&instantiate = function("fmi2Instantiate");
    if (!(instance = instantiate("one", 1, token, resources, &callbacks, 0, 1))) exit(3);
    CALL("fmi2SetupExperiment", (Instance, int, double, double, int, double), instance, 0, 0.0, 0.0, 0, 0.0);
    CALL("fmi2EnterInitializationMode", (Instance), instance);
    for (int i = 0; i < n; i++) get2(variables[i]);
    CALL("fmi2ExitInitializationMode", (Instance), instance);
    for (int k = 0; k < 3; k++) {
        CALL("fmi2DoStep", (Instance, double, double, int), instance, k * 0.01, 0.01, 1);
        double last;
        FILL(last);
        CALL("fmi2GetRealStatus", (Instance, int, double *), instance, 2, &last);
        WRITTEN("fmi2GetRealStatus", last);
        for (int i = 0; i < n; i++) get2(variables[i]);
    }
    round_trip("fmi2GetFMUstate", "fmi2SerializedFMUstateSize", "fmi2SerializeFMUstate", "fmi2DeSerializeFMUstate",
               "fmi2SetFMUstate", "fmi2FreeFMUstate");
    CALL("fmi2Terminate", (Instance), instance);
}

static void start3(const Variable *variables, int n) {
    if (!instance) exit(3);
    CALL("fmi3EnterInitializationMode", (Instance, bool, double, double, bool, double), instance, false, 0.0, 0.0,
         false, 0.0);
    for (int i = 0; i < n; i++) get3(variables[i]);
    CALL("fmi3ExitInitializationMode", (Instance), instance);
}

static void end3(void) {
    round_trip("fmi3GetFMUState", "fmi3SerializedFMUStateSize", "fmi3SerializeFMUState", "fmi3DeserializeFMUState",
               "fmi3SetFMUState", "fmi3FreeFMUState");
    CALL("fmi3Terminate", (Instance), instance);
}

static void run_cs3(const char *token, const char *resources, const Variable *variables, int n) {
    Instance (*instantiate)(const char *, const char *, const char *, bool, bool, bool, bool, const unsigned *, size_t,
                            void *, void *, void *);
    *(void **)&instantiate = function("fmi3InstantiateCoSimulation");
    instance = instantiate("one", token, resources, false, true, false, false, NULL, 0, NULL, logger3, NULL);
    start3(variables, n);
    for (int k = 0; k < 3; k++) {
        bool eventHandlingNeeded, terminateSimulation, earlyReturn;
        double lastSuccessfulTime;
        FILL(eventHandlingNeeded), FILL(terminateSimulation), FILL(earlyReturn), FILL(lastSuccessfulTime);
        CALL("fmi3DoStep", (Instance, double, double, bool, bool *, bool *, bool *, double *), instance, k * 0.01,
             0.01, true, &eventHandlingNeeded, &terminateSimulation, &earlyReturn, &lastSuccessfulTime);
        WRITTEN("fmi3DoStep", eventHandlingNeeded), WRITTEN("fmi3DoStep", terminateSimulation);
        WRITTEN("fmi3DoStep", earlyReturn), WRITTEN("fmi3DoStep", lastSuccessfulTime);
        for (int i = 0; i < n; i++) get3(variables[i]);
    }
    end3();
}

static void update_discrete_states(void) {
    for (int i = 0; i < MOST_UPDATES; i++) {
        bool discreteStatesNeedUpdate, terminateSimulation, nominalsOfContinuousStatesChanged;
        bool valuesOfContinuousStatesChanged, nextEventTimeDefined;
        double nextEventTime;
        FILL(discreteStatesNeedUpdate), FILL(terminateSimulation), FILL(nominalsOfContinuousStatesChanged);
        FILL(valuesOfContinuousStatesChanged), FILL(nextEventTimeDefined), FILL(nextEventTime);
        const char *name = "fmi3UpdateDiscreteStates";
        CALL(name, (Instance, bool *, bool *, bool *, bool *, bool *, double *), instance, &discreteStatesNeedUpdate,
             &terminateSimulation, &nominalsOfContinuousStatesChanged, &valuesOfContinuousStatesChanged,
             &nextEventTimeDefined, &nextEventTime);
        WRITTEN(name, discreteStatesNeedUpdate), WRITTEN(name, terminateSimulation);
        WRITTEN(name, nominalsOfContinuousStatesChanged), WRITTEN(name, valuesOfContinuousStatesChanged);
        WRITTEN(name, nextEventTimeDefined);
        if (nextEventTimeDefined) WRITTEN(name, nextEventTime);
        if (!discreteStatesNeedUpdate) return;
    }
    fprintf(stderr, "fmi3UpdateDiscreteStates has not ended after %d calls\n", MOST_UPDATES);
    exit(5);
}

static void run_me3(const char *token, const char *resources, const Variable *variables, int n) {
    Instance (*instantiate)(const char *, const char *, const char *, bool, bool, void *, void *);
    *(void **)&instantiate = function("fmi3InstantiateModelExchange");
    instance = instantiate("one", token, resources, false, true, NULL, logger3);
    start3(variables, n);
    update_discrete_states();
    CALL("fmi3EnterContinuousTimeMode", (Instance), instance);
    size_t n_states, n_indicators;
    FILL(n_states), FILL(n_indicators);
    CALL("fmi3GetNumberOfContinuousStates", (Instance, size_t *), instance, &n_states);
    CALL("fmi3GetNumberOfEventIndicators", (Instance, size_t *), instance, &n_indicators);
    WRITTEN("fmi3GetNumberOfContinuousStates", n_states), WRITTEN("fmi3GetNumberOfEventIndicators", n_indicators);
    static const char *const of_states[] = {"fmi3GetContinuousStates", "fmi3GetNominalsOfContinuousStates",
                                            "fmi3GetContinuousStateDerivatives"};
    double results[3][MOST_STATES], *x = results[0], *rates = results[2];
    for (int k = 0; k < 3; k++) {
        FILL(results);
        for (int j = 0; j < 3; j++) {
            CALL(of_states[j], (Instance, double *, size_t), instance, results[j], n_states);
            for (size_t i = 0; i < n_states; i++) written(of_states[j], "result", &results[j][i], sizeof(double));
        }
        CALL("fmi3GetEventIndicators", (Instance, double *, size_t), instance, NULL, n_indicators);
        for (size_t i = 0; i < n_states; i++) x[i] += 0.01 * rates[i];
        CALL("fmi3SetTime", (Instance, double), instance, (k + 1) * 0.01);
        CALL("fmi3SetContinuousStates", (Instance, const double *, size_t), instance, x, n_states);
        bool enterEventMode, terminateSimulation;
        FILL(enterEventMode), FILL(terminateSimulation);
        CALL("fmi3CompletedIntegratorStep", (Instance, bool, bool *, bool *), instance, true, &enterEventMode,
             &terminateSimulation);
        WRITTEN("fmi3CompletedIntegratorStep", enterEventMode);
        WRITTEN("fmi3CompletedIntegratorStep", terminateSimulation);
        for (int i = 0; i < n; i++) get3(variables[i]);
        CALL("fmi3EnterEventMode", (Instance), instance);
        update_discrete_states();
        CALL("fmi3EnterContinuousTimeMode", (Instance), instance);
    }
    end3();
}

int main(int n, char **argument) {
    library = dlopen(argument[2], RTLD_LAZY);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 2;
    }
    const int n_variables = (n - 5) / 2;
    Variable variables[n_variables + 1];
    for (int i = 0; i < n_variables; i++)
        variables[i] = (Variable){argument[5 + 2 * i], atoi(argument[6 + 2 * i])};
    if (!strcmp(argument[1], "cs2")) run_cs2(argument[3], argument[4], variables, n_variables);
    if (!strcmp(argument[1], "cs3")) run_cs3(argument[3], argument[4], variables, n_variables);
    if (!strcmp(argument[1], "me3")) run_me3(argument[3], argument[4], variables, n_variables);
    const char *release = argument[1][2] == '2' ? "fmi2FreeInstance" : "fmi3FreeInstance";
    ((void (*)(Instance))function(release))(instance);
    return 0;
}
