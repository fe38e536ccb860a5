/* A bare host: what tools do with an FMU, one situation at a time, by its C functions alone.

       host LIBRARY GUID LOCATION SITUATION TIMES FEED UNDERSIZE

   LOCATION: that of the resources, or NULL. TIMES: how often, where a situation is about many.
   FEED, UNDERSIZE: value references of the rates of these streams.
   Prints what came back: statuses in a line, numbers, and what was logged. As OMSimulator does, it
   aborts at a message without a category; as the standard says, it takes messages for formats. It
   ends as some hosts do, without terminating or freeing what lives. */
#include <dlfcn.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "fmi2Functions.h"

static const char *guid, *location;
static int times, loud = 1;
static fmi2CallbackFunctions callbacks;
static fmi2ValueReference feed, undersize;

#define CALLS(F)                                                                               \
    F(Instantiate) F(FreeInstance) F(SetupExperiment) F(EnterInitializationMode)               \
    F(ExitInitializationMode) F(Reset) F(SetReal) F(GetReal) F(DoStep) F(GetFMUstate)           \
    F(SetFMUstate) F(FreeFMUstate) F(GetRealStatus)
#define DECLARE(name) static fmi2##name##TYPE *name;
CALLS(DECLARE)

static void note(void *environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
    (void) environment, (void) name;
    if (!category) {
        printf("%d NULL\n", status), fflush(stdout);
        abort();
    }
    if (!loud || status == fmi2Warning) return; /* a screen that has just been started: alarms */
    va_list rest;
    va_start(rest, message);
    printf("%d %s ", status, category), vprintf(message, rest), putchar('\n');
    va_end(rest);
}

static fmi2Component make(void) {
    return Instantiate("screen", fmi2CoSimulation, guid, location, &callbacks, 0, 1);
}

static int start(fmi2Component c) {
    return SetupExperiment(c, 0, 0, 0, 0, 0) + EnterInitializationMode(c)
           + ExitInitializationMode(c);
}

static fmi2Component started(void) {
    fmi2Component c = make();
    if (!c || start(c)) printf("did not start\n"), exit(4);
    return c;
}

static int step(fmi2Component c, double now, double duration) { return DoStep(c, now, duration, 1); }

static double rate(fmi2Component c) {
    double value = NAN;
    GetReal(c, &undersize, 1, &value);
    return value;
}

static double reached(fmi2Component c) {
    double time = NAN;
    GetRealStatus(c, fmi2LastSuccessfulTime, &time);
    return time;
}

/* Memory of this process, kB. */
static long held(void) {
    long all, pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    if (!file || fscanf(file, "%ld %ld", &all, &pages) != 2) exit(5);
    fclose(file);
    return pages * (sysconf(_SC_PAGESIZE) / 1024);
}

static void run(void) {
    fmi2Component c = started();
    printf("%d\n", step(c, 0, 10));
    printf("%.17g\n", rate(c));
}

/* The screen is asked for what it cannot do; then it goes on. */
static void refused_steps(void) {
    static const double bad[] = {0, -1, NAN, INFINITY, 1e-310, 1e10}, less = -1, more = 80;
    fmi2Component c = started();
    printf("%d\n", step(c, 0, 10));
    for (int k = 0; k < 6; k++) printf("%d\n", step(c, 10, bad[k]));
    SetReal(c, &feed, 1, &less);
    printf("%d\n", step(c, 10, 1));
    SetReal(c, &feed, 1, &more);
    printf("%d\n", step(c, 10, 1));
    printf("%g\n%.17g\n", reached(c), rate(c));
}

static void refused_set(void) {
    fmi2Component c = started();
    double value = 1;
    printf("%d\n", SetReal(c, &undersize, 1, &value));
    printf("%d\n", step(c, 0, 1));
}

static void overwritten_callbacks(void) {
    fmi2Component c = started();
    memset(&callbacks, 0xA5, sizeof callbacks);
    printf("%d\n", step(c, 0, -1));
    printf("%d\n", step(c, 0, 1));
}

static void no_logger(void) {
    callbacks.logger = NULL;
    fmi2Component c = started();
    printf("%d\n", step(c, 0, -1));
    printf("%d\n", step(c, 0, 1));
}

static void other_guid(void) {
    guid = "%s%n%s";
    printf("%s\n", make() ? "an instance" : "none");
}

static void decimal_comma(void) {
    if (!setlocale(LC_ALL, "")) exit(6);
    printf("%s\n", localeconv()->decimal_point);
    fmi2Component c = started();
    printf("%d\n", step(c, 0, -1.5));
    printf("%d\n", step(c, 0, 1.5));
}

static void rollback(void) {
    fmi2Component c = started();
    fmi2FMUstate state = NULL;
    int status = step(c, 0, 1) + GetFMUstate(c, &state) + step(c, 1, 20);
    double then = rate(c);
    status += SetFMUstate(c, state);
    printf("%d %g\n", status, reached(c));
    status = step(c, 1, 20) + FreeFMUstate(c, &state);
    printf("%d %g %d\n", status, reached(c), rate(c) == then);
}

/* Statuses of many, and what the last two thirds of them left behind in memory. */
static void many(int (*one)(fmi2Component, int), fmi2Component c) {
    int status = 0;
    long before = 0;
    for (int k = 0; k < times; k++) {
        if (k == times / 3) before = held();
        status += one(c, k);
    }
    printf("%d\n%ld kB\n", status, held() - before);
}

static int an_instance(fmi2Component c, int number) {
    (void) number;
    c = started();
    int status = step(c, 0, 1);
    FreeInstance(c);
    return status;
}

static int a_reset(fmi2Component c, int number) {
    return (number ? start(c) : 0) + step(c, 0, 1) + Reset(c);
}

static int a_refusal(fmi2Component c, int number) {
    (void) number;
    return step(c, 0, -1) != fmi2OK;
}

static void instances_in_turn(void) { many(an_instance, NULL); }

static void resets(void) { many(a_reset, started()); }

static void refusals(void) {
    loud = 0;
    fmi2Component c = started();
    many(a_refusal, c);
    printf("%d\n", step(c, 0, 1));
}

static void instances_alive(void) {
    fmi2Component *c = calloc(times, sizeof *c);
    int status = 0;
    for (int k = 0; k < times; k++) {
        double more = 50 + k % 50;
        status += SetReal(c[k] = started(), &feed, 1, &more);
    }
    for (int k = 0; k < times; k++) status += step(c[k], 0, 60);
    int ordered = 1; /* more feed, more undersize */
    for (int k = 1; k < times; k++) ordered &= k % 50 == 0 || rate(c[k]) > rate(c[k - 1]);
    printf("%d %d\n", status, ordered);
    for (int k = 0; k < times; k++) FreeInstance(c[k]);
    free(c);
}

static void *work(void *value) {
    for (int k = 0; k < times; k++) {
        fmi2Component c = started();
        if (step(c, 0, 10)) exit(7);
        *(double *) value = rate(c);
        FreeInstance(c);
    }
    return NULL;
}

static void threads(void) {
    pthread_t thread[4];
    double value[4];
    for (int k = 0; k < 4; k++) pthread_create(&thread[k], NULL, work, &value[k]);
    for (int k = 0; k < 4; k++) pthread_join(thread[k], NULL);
    for (int k = 0; k < 4; k++) printf("%.17g\n", value[k]);
}

static void *made(void *place) { return *(fmi2Component *) place = started(), NULL; }

static void handed_on(void) { /* made in one thread, stepped in this */
    fmi2Component c = NULL;
    pthread_t thread;
    pthread_create(&thread, NULL, made, &c);
    pthread_join(thread, NULL);
    printf("%d\n", step(c, 0, 10));
    printf("%.17g\n", rate(c));
}

static void forked(void) {
    fmi2Component c = started();
    int status = step(c, 0, 10), end = -1;
    fflush(stdout);
    pid_t child = fork();
    if (!child) {
        double one = 0, other = rate(c);
        c = started();
        if (step(c, 0, 10) == 0) one = rate(c);
        _exit(one == other ? 0 : 8);
    }
    waitpid(child, &end, 0);
    printf("%d %d\n", end, status + step(c, 10, 1));
}

#define SITUATIONS(F)                                                                           \
    F(run) F(refused_steps) F(refused_set) F(overwritten_callbacks) F(no_logger) F(other_guid)   \
    F(decimal_comma) F(rollback) F(instances_in_turn) F(instances_alive) F(resets) F(refusals)   \
    F(threads) F(handed_on) F(forked)
#define ROW(name) {#name, name},
static const struct {
    const char *name;
    void (*play)(void);
} SITUATION[] = {SITUATIONS(ROW)};

int main(int count, char **given) {
    if (count != 8) return 2;
    void *library = dlopen(given[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        printf("%s\n", dlerror());
        return 3;
    }
#define LOOK_UP(name) *(void **) &name = dlsym(library, "fmi2" #name);
    CALLS(LOOK_UP)
    guid = given[2], location = strcmp(given[3], "NULL") ? given[3] : NULL;
    times = atoi(given[5]), feed = atoi(given[6]), undersize = atoi(given[7]);
    callbacks = (fmi2CallbackFunctions){note, calloc, free, NULL, NULL};
    setvbuf(stdout, NULL, _IOLBF, 0);
    for (size_t k = 0; k < sizeof SITUATION / sizeof *SITUATION; k++)
        if (!strcmp(given[4], SITUATION[k].name)) return SITUATION[k].play(), 0;
    return 2;
}
