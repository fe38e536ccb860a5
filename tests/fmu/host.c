/* A host that is not Python: runs the library of an FMU, steps that are refused among them.

   host LIBRARY GUID RESOURCES INPUT OUTPUT: value references of an input and of a real output. */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"

static void note(void *environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
    (void) environment, (void) name;
    printf("%d %s %s\n", status, category ? category : "NULL", message);
}

#define FIND(type, name) \
    type *name = NULL;   \
    *(void **) &name = dlsym(library, "fmi2" #name);

int main(int count, char **given) {
    if (count != 6) return 2;
    void *library = dlopen(given[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        printf("%s\n", dlerror());
        return 3;
    }
    FIND(fmi2InstantiateTYPE, Instantiate)
    FIND(fmi2SetupExperimentTYPE, SetupExperiment)
    FIND(fmi2EnterInitializationModeTYPE, EnterInitializationMode)
    FIND(fmi2ExitInitializationModeTYPE, ExitInitializationMode)
    FIND(fmi2SetRealTYPE, SetReal)
    FIND(fmi2GetRealTYPE, GetReal)
    FIND(fmi2DoStepTYPE, DoStep)
    fmi2CallbackFunctions callbacks = {note, calloc, free, NULL, NULL};
    fmi2Component c = Instantiate("screen", fmi2CoSimulation, given[2], given[3], &callbacks, 0, 1);
    if (!c) return 4;
    int status = SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0);
    status += EnterInitializationMode(c) + ExitInitializationMode(c) + DoStep(c, 0.0, 10.0, 1);
    printf("%d\n", status);
    fmi2ValueReference input = atoi(given[4]), output = atoi(given[5]);
    double bad = -1.0, good = 80.0, value;
    SetReal(c, &input, 1, &bad);
    for (int k = 0; k < 3; k++) printf("%d\n", DoStep(c, 10.0, 1.0, 1));
    SetReal(c, &input, 1, &good);
    printf("%d\n", DoStep(c, 10.0, 1.0, 1));
    GetReal(c, &output, 1, &value);
    printf("%.17g\n", value);
    fflush(stdout);
    return 0; /* ends as some hosts do: without terminating or freeing the instance */
}
