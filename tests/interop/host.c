/* An FMI 2.0 host that is not Python: host LIBRARY GUID RESOURCES STEPS STEP_SIZE CHANGE_AT PARAMETER VALUE OUTPUT...

   The parameter is set before the step with the number CHANGE_AT; variables go by value reference. Prints the outputs
   after each step. Exit codes: 0 done, 2 no library, 3 no instance, 4 a call that did not return OK. */
#include <dlfcn.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

typedef void *Component;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished, *environment;
} Callbacks;

static void logger(void *environment, const char *instance, int status, const char *category, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

int main(int n, char **argument) {
    static const Callbacks callbacks = {logger, calloc, free, NULL, NULL};
    void *library = dlopen(argument[1], RTLD_LAZY);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 2;
    }
    Component (*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
    int (*setup)(Component, int, double, double, int, double), (*enter)(Component), (*leave)(Component);
    int (*set)(Component, const unsigned *, size_t, const double *), (*step)(Component, double, double, int);
    int (*get)(Component, const unsigned *, size_t, double *), (*terminate)(Component);
    void (*release)(Component);
    *(void **)&instantiate = dlsym(library, "fmi2Instantiate");
    *(void **)&setup = dlsym(library, "fmi2SetupExperiment");
    *(void **)&enter = dlsym(library, "fmi2EnterInitializationMode");
    *(void **)&leave = dlsym(library, "fmi2ExitInitializationMode");
    *(void **)&set = dlsym(library, "fmi2SetReal");
    *(void **)&step = dlsym(library, "fmi2DoStep");
    *(void **)&get = dlsym(library, "fmi2GetReal");
    *(void **)&terminate = dlsym(library, "fmi2Terminate");
    *(void **)&release = dlsym(library, "fmi2FreeInstance");

    Component component = instantiate("host", 1, argument[2], argument[3], &callbacks, 0, 1);
    if (!component) return 3;
    if (setup(component, 0, 0.0, 0.0, 0, 0.0) || enter(component) || leave(component)) return 4;
    const int n_steps = atoi(argument[4]), change_at = atoi(argument[6]);
    const double step_size = atof(argument[5]), value = atof(argument[8]);
    const unsigned parameter = atoi(argument[7]);
    for (int k = 0; k < n_steps; k++) {
        if (k == change_at && set(component, &parameter, 1, &value)) return 4;
        if (step(component, k * step_size, step_size, 1)) return 4;
        for (int i = 9; i < n; i++) {
            const unsigned reference = atoi(argument[i]);
            double output = NAN;  // what is not written shows
            if (get(component, &reference, 1, &output)) return 4;
            printf("%.17g%c", output, i + 1 < n ? ' ' : '\n');
        }
    }
    if (terminate(component)) return 4;
    release(component);
    return 0;
}
