/* What does a day of plant time cost when a program in C runs the screen? One with a steady feed, and
   one with a feed that never rests: it wanders by 5 % around its duty with a memory of a minute.

   python build_fmu.py && unzip -oq dist/VibratingScreen.fmu -d dist/screen
   cc -O2 plant_examples/day_of_plant.c -I "$(python -c 'import fmpy; print(fmpy.__path__[0])')/c-code" \
       -ldl -lm -o dist/day && dist/day dist/screen [SECONDS] */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"

#define FMI(name) ((name##TYPE *) dlsym(library, #name))

static void say(void *host, fmi2String instance, fmi2Status status, fmi2String category, fmi2String text, ...) {
    (void) host, (void) status;
    printf("%s, %s: %s\n", instance, category, text);
}

/* What stands in quotes after the first `name` behind the first `at` of modelDescription.xml. */
static char *attribute(const char *xml, const char *at, const char *name) {
    static char value[64];
    const char *place = strstr(xml, at);
    if (!place || !(place = strstr(place, name)) || sscanf(place + strlen(name), "=\"%63[^\"]", value) != 1)
        fprintf(stderr, "%s of %s is missing\n", name, at), exit(1);
    return value;
}

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double) now.tv_sec + 1e-9 * (double) now.tv_nsec;
}

int main(int count, char **arguments) {
    static char path[4096], xml[1 << 20];
    int end = count > 2 ? atoi(arguments[2]) : 86400;
    snprintf(path, sizeof path, "%s/modelDescription.xml", count > 1 ? arguments[1] : ".");
    FILE *file = fopen(path, "rb");
    if (!file || !fread(xml, 1, sizeof xml - 1, file)) return fprintf(stderr, "no %s\n", path), 1;
    snprintf(path, sizeof path, "%s/binaries/linux64/VibratingScreen.so", arguments[1]);
    void *library = dlopen(path, RTLD_NOW);
    if (!library) return fprintf(stderr, "%s\n", dlerror()), 1;
    fmi2CallbackFunctions callbacks = {.logger = say, .allocateMemory = calloc, .freeMemory = free};
    unsigned feed = (unsigned) atoi(attribute(xml, "name=\"feed.mass_flow_rate\"", "valueReference"));
    unsigned fine = (unsigned) atoi(attribute(xml, "name=\"undersize.mass\"", "valueReference"));
    for (int noisy = 0; noisy < 2; noisy++) {
        double rate = 0, undersize = 0, noise = 0, began = seconds();
        fmi2Component screen = FMI(fmi2Instantiate)("screen", fmi2CoSimulation, attribute(xml, "<fmi", "guid"), "", &callbacks, 0, 1);
        fmi2Status status = screen ? fmi2OK : fmi2Fatal;
        if (screen) FMI(fmi2GetReal)(screen, &feed, 1, &rate);
        double duty = rate;
        if (screen) FMI(fmi2SetupExperiment)(screen, 0, 0, 0, 1, end), FMI(fmi2EnterInitializationMode)(screen);
        if (screen) status = FMI(fmi2ExitInitializationMode)(screen);
        for (int second = 0; second < end && status == fmi2OK; second++) {
            noise += noisy * (sqrt(2 / 60.0) * 0.05 * 1.7 * (2.0 * rand() / RAND_MAX - 1) - noise / 60);
            rate = duty * (1 + noise);
            FMI(fmi2SetReal)(screen, &feed, 1, &rate);
            status = FMI(fmi2DoStep)(screen, second, 1, 1);
            FMI(fmi2GetReal)(screen, &fine, 1, &undersize);
        }
        if (status != fmi2OK) return 1;
        FMI(fmi2FreeInstance)(screen);
        printf("%s feed: %.1f t of undersize in %d s, computed in %.3f s\n", noisy ? "restless" : "steady", undersize / 1000, end, seconds() - began);
    }
    return 0;
}
