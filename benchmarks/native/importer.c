/* A C importer: steps one FMI 2.0 co-simulation FMU and prints the time of a step.

   importer LIBRARY GUID RESOURCES N_STEPS N_BLOCKS N_INPUTS vr value ... N_OUTPUTS vr ...
   A step sets the inputs, steps 10 ms and gets the outputs. Prints the microseconds a step of each block, then the
   outputs. The headers are FMPy's (fmpy/c-code). */

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2FunctionTypes.h"

#define MOST 64

static void log_message(fmi2ComponentEnvironment e, fmi2String instance, fmi2Status status, fmi2String category,
                        fmi2String message, ...) {
    fprintf(stderr, "%s: %s\n", instance, message);
}

static void *function(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "no %s\n", name);
        exit(1);
    }
    return found;
}

static void check(fmi2Status status, const char *name) {
    if (status > fmi2Warning) {
        fprintf(stderr, "%s returned %d\n", name, status);
        exit(1);
    }
}

int main(int argc, char **argv) {
    const double h = 0.01;
    fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
    fmi2ValueReference input[MOST], output[MOST];
    double u[MOST], y[MOST];
    char **next = argv + 4;
    int n_steps = atoi(*next++), n_blocks = atoi(*next++), n_inputs = atoi(*next++), n_outputs;
    for (int i = 0; i < n_inputs; i++) input[i] = atoi(*next++), u[i] = atof(*next++);
    n_outputs = atoi(*next++);
    for (int i = 0; i < n_outputs; i++) output[i] = atoi(*next++);

    void *library = dlopen(argv[1], RTLD_NOW);
    if (!library) return fprintf(stderr, "%s\n", dlerror()), 1;
    fmi2InstantiateTYPE *instantiate = function(library, "fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = function(library, "fmi2SetupExperiment");
    fmi2EnterInitializationModeTYPE *enter = function(library, "fmi2EnterInitializationMode");
    fmi2ExitInitializationModeTYPE *leave = function(library, "fmi2ExitInitializationMode");
    fmi2SetRealTYPE *set = function(library, "fmi2SetReal");
    fmi2GetRealTYPE *get = function(library, "fmi2GetReal");
    fmi2DoStepTYPE *do_step = function(library, "fmi2DoStep");

    fmi2Component c = instantiate("importer", fmi2CoSimulation, argv[2], argv[3], &callbacks, fmi2False, fmi2False);
    if (!c) return fprintf(stderr, "fmi2Instantiate failed\n"), 1;
    check(setup(c, fmi2False, 0.0, 0.0, fmi2False, 0.0), "fmi2SetupExperiment");
    check(enter(c), "fmi2EnterInitializationMode");
    check(leave(c), "fmi2ExitInitializationMode");
    for (int block = 0, k = 0; block < n_blocks; block++) {
        struct timespec begun, ended;
        clock_gettime(CLOCK_MONOTONIC, &begun);
        for (int i = 0; i < n_steps; i++, k++) {
            check(set(c, input, n_inputs, u), "fmi2SetReal");
            check(do_step(c, k * h, h, fmi2True), "fmi2DoStep");
            check(get(c, output, n_outputs, y), "fmi2GetReal");
        }
        clock_gettime(CLOCK_MONOTONIC, &ended);
        printf("%.6f ", ((ended.tv_sec - begun.tv_sec) * 1e6 + (ended.tv_nsec - begun.tv_nsec) * 1e-3) / n_steps);
    }
    printf("\n");
    for (int i = 0; i < n_outputs; i++) printf("%.17g ", y[i]);
    printf("\n");
    fflush(stdout);
    _Exit(0); /* the interpreter inside need not be taken down */
}
