/* An FMI 2.0 co-simulation FMU that fails in the way `how`, in the function `where`, from t = 0.02 s on.

   Until then y = u. An instance whose name begins with "instantiate: " fails as it is made, the way that follows.
   Leaves a file at $PYTHON_FAULT_MARKER as soon as it is loaded, for the proof that it was not. */

#define _GNU_SOURCE
#include <fenv.h>
#include <fcntl.h>
#include <locale.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include "fmi2Functions.h"

enum { U, Y, LIMITED, N };

typedef struct {
    double v[N];
    char how[64], where[64];
    const fmi2CallbackFunctions *f;
    int is_due;
} Model;

static jmp_buf place;
static volatile double sink, zero_real = 0.0;
static volatile int zero = 0, one = 1;

__attribute__((constructor)) static void leave_a_trace(void) {
    const char *path = getenv("PYTHON_FAULT_MARKER");
    if (path) close(open(path, O_CREAT | O_WRONLY, 0600));
}

#ifdef NEEDS_WHAT_IS_NOWHERE
extern int function_that_is_nowhere(void);
int call_it(void) { return function_that_is_nowhere(); }
#endif

static int deeper(volatile int n) {
    volatile char page[4096];
    page[n % 4096] = (char)n;
    return deeper(n + 1) + page[0];
}
static void *spin(void *_) {
    for (;;) sink += 1.0;
    return _;
}
static void ignore(int number) { (void)number; }
static void handler_that_exits(int number) { _exit(number ? 0 : 1); }
static void __attribute__((noinline)) smash(volatile int n) {
    volatile char small[8];
    for (int i = 0; i < n; i++) small[i] = 'x';
}

#define IS(name) (strcmp(how, name) == 0)

static fmi2Status fail(Model *m, const char *how) {
    if (IS("")) return fmi2OK;
    if (IS("warn")) return fmi2Warning;
    if (IS("discard")) return fmi2Discard;
    if (IS("error")) return fmi2Error;
    if (IS("fatal")) return fmi2Fatal;
    if (IS("pending")) return fmi2Pending;
    if (IS("status 17")) return (fmi2Status)17;
    if (IS("status -1")) return (fmi2Status)-1;
    if (IS("segfault")) *(volatile int *)0 = 1;
    if (IS("jump to nowhere")) ((void (*)(void))8)();
    if (IS("write to code")) *(volatile char *)(void *)fail = 1;
    if (IS("abort")) abort();
    if (IS("exit 0")) exit(0);
    if (IS("quick exit 0")) _exit(0);
    if (IS("exit 130")) exit(130);
    if (IS("loop")) for (;;) sink += 1.0;
    if (IS("sleep")) for (;;) sleep(1000);
    if (IS("read input")) return getchar() == EOF ? fmi2Error : fmi2OK;
    if (IS("deadlock")) {
        static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
        pthread_mutex_lock(&lock);
        pthread_mutex_lock(&lock);
    }
    if (IS("stop")) raise(SIGSTOP);
    if (IS("stack overflow")) sink = deeper(0);
    if (IS("allocate")) for (;;) memset(malloc(1 << 24), 1, 1 << 24);
    if (IS("allocate once")) { char *p = malloc(1 << 28); memset(p, 1, 1 << 28); sleep(1000); sink = p[9]; }
    if (IS("double free")) { char *p = malloc(4000); sink = (double)(size_t)p; free(p); free(p); }
    if (IS("free the stack")) { char p[64]; memset(p, 0, 64); sink = p[3]; free((void *)(p + 16)); }
    if (IS("overrun the heap")) { volatile char *p = malloc(24); for (long i = 0; i < 1L << 30; i++) p[i] = 'x'; }
    if (IS("smash the stack")) smash(4096);
    if (IS("divide by zero")) sink = (7 * one) / zero;
    if (IS("illegal instruction")) __builtin_trap();
    if (IS("bus error")) {
        FILE *file = tmpfile();
        char *p = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, fileno(file), 0);
        p[0] = 1;
    }
    if (IS("longjmp")) longjmp(place, 1);
    if (IS("trap floating point")) { feenableexcept(FE_DIVBYZERO | FE_INVALID); sink = 1.0 / zero_real; }
    if (IS("nan")) m->v[Y] = zero_real / zero_real;
    if (IS("inf")) m->v[Y] = 1.0 / zero_real;
    if (IS("out of range")) m->v[LIMITED] = 11.0;
    if (IS("kill its group")) { kill(0, SIGTERM); sleep(1000); }
    if (IS("alarm")) { alarm(1); sleep(1000); }
    if (IS("broken pipe")) { int ends[2]; if (!pipe(ends)) close(ends[0]); signal(SIGPIPE, SIG_DFL); sink = write(ends[1], "x", 1); }
    if (IS("limit itself")) { struct rlimit none = {1, 1}; setrlimit(RLIMIT_CPU, &none); for (;;) sink += 1.0; }
    if (IS("close everything")) { for (int i = 0; i < 256; i++) close(i); for (;;) sleep(1000); }
    if (IS("leave a child and exit")) { if (!fork()) for (;;) sleep(1000); _exit(0); }
    if (IS("leave a daemon and exit")) { if (!fork()) { setsid(); if (!fork()) for (;;) sleep(1000); _exit(0); } _exit(0); }
    if (IS("leave a daemon")) { if (!fork()) { setsid(); if (!fork()) for (;;) sleep(1000); _exit(0); } }
    if (IS("log without end"))
        for (;;) m->f->logger(m->f->componentEnvironment, "me", fmi2OK, "flood", "line after line");
    if (IS("log and fail")) {
        m->f->logger(m->f->componentEnvironment, "me", fmi2Error, "why", "step of %g s is %s", 0.01, "too long");
        return fmi2Error;
    }
    if (IS("log a page and fail")) {
        char page[20000];
        memset(page, 'a', sizeof page);
        for (int i = 80; i < 20000; i += 80) page[i] = '\n';
        page[sizeof page - 1] = 0;
        m->f->logger(m->f->componentEnvironment, "me", fmi2Error, "why", "%s", page);
        return fmi2Error;
    }
    /* What disturbs, but need not fail. */
    if (IS("log a warning")) m->f->logger(m->f->componentEnvironment, "me", fmi2Warning, "w", "the step is long");
    if (IS("log many lines"))
        for (int i = 0; i < 100000; i++) m->f->logger(m->f->componentEnvironment, "me", fmi2Warning, "w", "line %d", i);
    if (IS("print")) { printf("to standard output\n"); fprintf(stderr, "to standard error\n"); fflush(stdout); }
    if (IS("print without end")) for (int i = 0; i < 300000; i++) fprintf(i % 2 ? stderr : stdout, "line %d\n", i);
    if (IS("print bytes")) { for (int i = 0; i < 256; i++) putchar(i); fflush(stdout); }
    if (IS("round upwards")) fesetround(FE_UPWARD);
#ifdef __SSE__
    if (IS("flush denormals")) __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);
#endif
    if (IS("change directory")) sink = chdir("/");
    if (IS("change environment")) { setenv("HOME", "/nowhere", 1); unsetenv("PATH"); }
    if (IS("change locale")) setlocale(LC_ALL, "C.UTF-8");
    if (IS("take signals")) { signal(SIGINT, ignore); signal(SIGTERM, ignore); signal(SIGSEGV, handler_that_exits); }
    if (IS("start a thread")) { pthread_t t; pthread_create(&t, NULL, spin, NULL); }
    if (IS("non-blocking output")) fcntl(2, F_SETFL, fcntl(2, F_GETFL) | O_NONBLOCK);
    if (IS("register an exit handler")) atexit(abort);
    return fmi2OK;
}

static fmi2Status at(Model *m, const char *where) {
    int is_early = strstr(where, "init") || strcmp(where, "terminate") == 0 || strcmp(where, "free") == 0;
    return strcmp(m->where, where) == 0 && (m->is_due || is_early) ? fail(m, m->how) : fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m = calloc(1, sizeof *m);
    m->f = functions;
    if (strncmp(name, "instantiate: ", 13) == 0) {
        if (strcmp(name + 13, "return NULL") == 0) return NULL;
        fail(m, name + 13);
    }
    if (setjmp(place)) return NULL;
    return m;
}
void fmi2FreeInstance(fmi2Component c) {
    at(c, "free");
    free(c);
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real from,
                               fmi2Boolean has_stop, fmi2Real stop) {
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return at(c, "enter_init"); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return at(c, "exit_init"); }
fmi2Status fmi2Terminate(fmi2Component c) { return at(c, "terminate"); }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Model *m = c;
    fmi2Status status = at(m, "get");
    if (m->is_due && strcmp(m->where, "fill nothing") == 0) return fmi2OK;
    for (size_t i = 0; i < n; i++) value[i] = m->v[vr[i]];
    return status;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->v[vr[i]] = value[i];
    return at(c, "set");
}
#ifndef WITHOUT_DO_STEP
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean forward_only) {
    Model *m = c;
    m->is_due = t > 0.015;
    m->v[Y] = m->v[U];
    return at(m, "do_step");
}
#endif
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) snprintf(vr[i] ? m->where : m->how, 64, "%s", value[i]);
    return fmi2OK;
}
#define NONE(name, ...) fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
NONE(fmi2GetInteger, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
NONE(fmi2GetBoolean, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
NONE(fmi2GetString, const fmi2ValueReference vr[], size_t n, fmi2String value[])
NONE(fmi2SetInteger, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
NONE(fmi2SetBoolean, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
NONE(fmi2SetFMUstate, fmi2FMUstate state)
NONE(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
NONE(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { *state = c; return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { *state = NULL; return fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    *size = (size_t)300000000;
    return fmi2OK;
}
NONE(fmi2GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t n, const fmi2ValueReference known[],
     size_t m, const fmi2Real seed[], fmi2Real result[])
NONE(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
     const fmi2Real value[])
NONE(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[])
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
NONE(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
NONE(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
NONE(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
NONE(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
NONE(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
