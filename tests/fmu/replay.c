/* Replays calls of FMI 2.0 from a file and writes down all that comes back:

       replay LIBRARY CALLS OUT [RESOURCES]

   The same calls give the same bytes on every platform and from the runtime in Python
   (tests/fmu/native.py writes CALLS and knows the answer). Needs nothing but a C library. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"
#ifdef _WIN32
#include <windows.h>
#define OPEN(path) ((void *) LoadLibraryA(path))
#define FIND(library, name) ((void *) GetProcAddress((HMODULE) library, name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#endif

/* Taken from the heap so far; counted where the C library lets us (-rdynamic: for the library too). */
static long taken;
#ifdef COUNT_ALLOCATIONS
void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *malloc(size_t size) { return taken++, __libc_malloc(size); }
void *calloc(size_t n, size_t size) { return taken++, __libc_calloc(n, size); }
#endif

static FILE *calls, *out;
static void *library;
static char guid[64];
static const char *resources = "";

static void *find(const char *name) {
    void *function = FIND(library, name);
    if (!function) fprintf(stderr, "%s is missing\n", name), exit(2);
    return function;
}
#define CALL(name) ((name##TYPE *) find(#name))

static void take(void *bytes, size_t size) {
    if (size && fread(bytes, 1, size, calls) != size) fprintf(stderr, "the calls end too soon\n"), exit(2);
}

static uint32_t take_count(void) {
    uint32_t n = 0;
    take(&n, sizeof n);
    return n;
}

static void *take_many(size_t n, size_t size) {
    void *values = calloc(n + 1, size);
    take(values, n * size);
    return values;
}

static void put(const void *bytes, size_t size) { fwrite(bytes, 1, size, out); }

static void put_status(fmi2Status status) { fputc((int) status, out); }

static void hear(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
    (void) environment, (void) instance, (void) status;
    fputs(category, out), fputc(' ', out), fputs(message, out), fputc('\n', out);
}

static const fmi2CallbackFunctions CALLBACKS = {.logger = hear, .allocateMemory = calloc, .freeMemory = free};

static fmi2Component make(void) {
    fmi2Component c = CALL(fmi2Instantiate)("screen", fmi2CoSimulation, guid, resources, &CALLBACKS, 0, 1);
    if (!c) fprintf(stderr, "no instance\n"), exit(2);
    return c;
}

static void checked_sum(const unsigned char *bytes, size_t size) {
    uint32_t sum = 0xFFFFFFFFu;
    for (size_t k = 0; k < size; k++) {
        sum ^= bytes[k];
        for (int bit = 0; bit < 8; bit++) sum = sum >> 1 ^ (sum & 1 ? 0xEDB88320u : 0);
    }
    sum = ~sum;
    put(&sum, sizeof sum);
}

/* The state as bytes; the caller frees them. */
static fmi2Byte *written(fmi2Component c, size_t *size) {
    fmi2FMUstate state = NULL;
    if (CALL(fmi2GetFMUstate)(c, &state) || CALL(fmi2SerializedFMUstateSize)(c, state, size)) exit(3);
    fmi2Byte *bytes = malloc(*size);
    if (CALL(fmi2SerializeFMUstate)(c, state, bytes, *size)) exit(3);
    if (CALL(fmi2FreeFMUstate)(c, &state) || state) exit(3);
    return bytes;
}

static void set_bytes(fmi2Component c, const fmi2Byte *bytes, size_t size) {
    fmi2FMUstate state = NULL;
    fmi2Status status = CALL(fmi2DeSerializeFMUstate)(c, bytes, size, &state);
    if (status == fmi2OK) status = CALL(fmi2SetFMUstate)(c, state);
    put_status(status);
    CALL(fmi2FreeFMUstate)(c, &state);
}

static void put_cost(clock_t begun, double times) {
    double microseconds = 1e6 * (double) (clock() - begun) / CLOCKS_PER_SEC / times;
    put(&microseconds, sizeof microseconds);
}

static void start(fmi2Component c) {
    if (CALL(fmi2SetupExperiment)(c, 0, 0, 0, 0, 0) || CALL(fmi2EnterInitializationMode)(c)
        || CALL(fmi2ExitInitializationMode)(c))
        exit(3);
}

/* Cost of an instance with its first step, us of processor time, over so many. */
static void measure_start(uint32_t times) {
    clock_t begun = clock();
    for (uint32_t k = 0; k < times; k++) {
        fmi2Component c = make();
        start(c);
        if (CALL(fmi2DoStep)(c, 0, 1, 1)) exit(3);
        CALL(fmi2FreeInstance)(c);
    }
    put_cost(begun, times);
}

/* Cost of a step of 1 s with values set and got, us of processor time. The first value wanders about
   its start by the part `noise`, with a memory of a minute; 0: nothing changes. */
static void measure_steps(fmi2Component c) {
    uint32_t times = take_count(), gets, sets = take_count();
    fmi2ValueReference *to_set = take_many(sets, sizeof *to_set);
    double *given = take_many(sets, sizeof *given), noise, part = 0, first = given[0];
    fmi2ValueReference *to_get = take_many(gets = take_count(), sizeof *to_get);
    double *got = calloc(gets + 1, sizeof *got);
    take(&noise, sizeof noise);
    fmi2SetRealTYPE *set = CALL(fmi2SetReal);
    fmi2GetRealTYPE *get = CALL(fmi2GetReal);
    fmi2DoStepTYPE *step = CALL(fmi2DoStep);
    clock_t begun = clock();
    for (uint32_t k = 0; k < times; k++) {
        part += 0.3 * noise * (2.0 * rand() / RAND_MAX - 1) - part / 60;
        given[0] = first * (1 + part);
        if (set(c, to_set, sets, given) || step(c, k, 1, 1) || get(c, to_get, gets, got)) exit(3);
    }
    put_cost(begun, times);
    free(to_set), free(given), free(to_get), free(got);
}

int main(int count, char **arguments) {
    if (count == 5) resources = arguments[4];
    if (count < 4 || !(library = OPEN(arguments[1])) || !(calls = fopen(arguments[2], "rb"))
        || !(out = fopen(arguments[3], "wb")))
        return fprintf(stderr, "replay LIBRARY CALLS OUT [RESOURCES]\n"), 2;
    take(guid, 38);
    fmi2Component c = make();
    fmi2FMUstate kept = NULL;
    for (int call; (call = fgetc(calls)) != EOF;) {
        double duration, now = 0;
        uint32_t n;
        size_t size = 0;
        if (call == 'R' || call == 'I' || call == 'r' || call == 'b') {
            n = take_count();
            fmi2ValueReference *vr = take_many(n, sizeof *vr);
            if (call == 'R') {
                double *value = take_many(n, sizeof *value);
                put_status(CALL(fmi2SetReal)(c, vr, n, value));
                free(value);
            } else if (call == 'I') {
                int32_t *value = take_many(n, sizeof *value);
                put_status(CALL(fmi2SetInteger)(c, vr, n, value));
                free(value);
            } else if (call == 'r') {
                double *value = calloc(n + 1, sizeof *value);
                put_status(CALL(fmi2GetReal)(c, vr, n, value));
                put(value, n * sizeof *value);
                free(value);
            } else {
                int32_t *value = calloc(n + 1, sizeof *value);
                put_status(CALL(fmi2GetBoolean)(c, vr, n, value));
                put(value, n * sizeof *value);
                free(value);
            }
            free(vr);
        } else if (call == 'D') {
            take(&duration, sizeof duration);
            fmi2DoStepTYPE *step = CALL(fmi2DoStep);
            long before = taken;
            fmi2Status status = step(c, now, duration, 1);
            if (status == fmi2OK && taken != before) return fprintf(stderr, "a step took memory\n"), 4;
            put_status(status);
        } else if (call == 't') {
            take(&duration, sizeof duration);
            put_status(CALL(fmi2SetupExperiment)(c, 1, duration, 0, 0, 0));
        } else if (call == 'X') {
            CALL(fmi2SetupExperiment)(c, 0, 0, 0, 0, 0);
            CALL(fmi2EnterInitializationMode)(c);
            put_status(CALL(fmi2ExitInitializationMode)(c));
        } else if (call == 'T') put_status(CALL(fmi2Terminate)(c));
        else if (call == 'Z') put_status(CALL(fmi2Reset)(c));
        else if (call == 'S') { /* length and checksum of the state */
            fmi2Byte *bytes = written(c, &size);
            put(&size, 8);
            checked_sum((unsigned char *) bytes, size);
            free(bytes);
        } else if (call == 'K') put_status(CALL(fmi2GetFMUstate)(c, &kept));
        else if (call == 'k') put_status(kept ? CALL(fmi2SetFMUstate)(c, kept) : fmi2OK);
        else if (call == 'N') { /* go on in another instance, by bytes */
            fmi2Byte *bytes = written(c, &size);
            if (kept) CALL(fmi2FreeFMUstate)(c, &kept);
            CALL(fmi2FreeInstance)(c);
            c = make();
            set_bytes(c, bytes, size);
            free(bytes);
        } else if (call == 'B') { /* bytes that may be no state */
            n = take_count();
            fmi2Byte *bytes = take_many(n, 1);
            set_bytes(c, bytes, n);
            free(bytes);
        } else if (call == 'C') { /* a state of this instance with a byte changed, or cut */
            n = take_count();
            fmi2Byte *bytes = written(c, &size);
            bytes[n % size] ^= 1;
            set_bytes(c, bytes, size);
            bytes[n % size] ^= 1;
            set_bytes(c, bytes, n % size);
            free(bytes);
        } else if (call == 'P') { /* pointers to nothing: a status, no crash */
            fmi2ValueReference vr = 0;
            double value = 0;
            int refused = CALL(fmi2GetReal)(c, NULL, 1, &value) == fmi2Error;
            refused += CALL(fmi2SetReal)(c, &vr, 1, NULL) == fmi2Error;
            refused += CALL(fmi2DoStep)(NULL, 0, 1, 1) == fmi2Error;
            refused += CALL(fmi2GetFMUstate)(c, NULL) == fmi2Error;
            refused += CALL(fmi2SetFMUstate)(c, NULL) == fmi2Error;
            refused += CALL(fmi2CancelStep)(c) == fmi2Error;
            refused += CALL(fmi2GetReal)(c, NULL, 0, NULL) == fmi2OK;
            refused += CALL(fmi2GetString)(c, NULL, 0, NULL) == fmi2OK;
            CALL(fmi2FreeInstance)(NULL);
            fputc(refused, out);
        } else if (call == 'm') measure_start(take_count());
        else if (call == 'M') measure_steps(c);
        else return fprintf(stderr, "call %d is unknown\n", call), 2;
    }
    if (kept) CALL(fmi2FreeFMUstate)(c, &kept);
    CALL(fmi2FreeInstance)(c);
    return fclose(out) || fclose(calls);
}
