/* The part of FMI 2.0 for co-simulation: its types and functions. */
#include <stddef.h>

#ifdef _WIN32
#define SHOWN __declspec(dllexport)
#else
#define SHOWN __attribute__((visibility("default")))
#endif

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment, fmi2String name, fmi2Status, fmi2String category,
                                   fmi2String message, ...);
typedef struct {
    fmi2CallbackLogger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#define VALUES(kind) fmi2Component, const fmi2ValueReference[], size_t, kind[]
SHOWN const char *fmi2GetTypesPlatform(void);
SHOWN const char *fmi2GetVersion(void);
SHOWN fmi2Component fmi2Instantiate(fmi2String name, fmi2Type, fmi2String guid, fmi2String resources,
                                    const fmi2CallbackFunctions *, fmi2Boolean visible, fmi2Boolean logging);
SHOWN void fmi2FreeInstance(fmi2Component);
SHOWN fmi2Status fmi2SetDebugLogging(fmi2Component, fmi2Boolean on, size_t, const fmi2String categories[]);
SHOWN fmi2Status fmi2SetupExperiment(fmi2Component, fmi2Boolean bounded, fmi2Real tolerance, fmi2Real begin,
                                     fmi2Boolean ends, fmi2Real end);
SHOWN fmi2Status fmi2EnterInitializationMode(fmi2Component);
SHOWN fmi2Status fmi2ExitInitializationMode(fmi2Component);
SHOWN fmi2Status fmi2Terminate(fmi2Component);
SHOWN fmi2Status fmi2Reset(fmi2Component);
SHOWN fmi2Status fmi2GetReal(VALUES(fmi2Real));
SHOWN fmi2Status fmi2GetInteger(VALUES(fmi2Integer));
SHOWN fmi2Status fmi2GetBoolean(VALUES(fmi2Boolean));
SHOWN fmi2Status fmi2GetString(VALUES(fmi2String));
SHOWN fmi2Status fmi2SetReal(VALUES(const fmi2Real));
SHOWN fmi2Status fmi2SetInteger(VALUES(const fmi2Integer));
SHOWN fmi2Status fmi2SetBoolean(VALUES(const fmi2Boolean));
SHOWN fmi2Status fmi2SetString(VALUES(const fmi2String));
SHOWN fmi2Status fmi2GetFMUstate(fmi2Component, fmi2FMUstate *);
SHOWN fmi2Status fmi2SetFMUstate(fmi2Component, fmi2FMUstate);
SHOWN fmi2Status fmi2FreeFMUstate(fmi2Component, fmi2FMUstate *);
SHOWN fmi2Status fmi2SerializedFMUstateSize(fmi2Component, fmi2FMUstate, size_t *);
SHOWN fmi2Status fmi2SerializeFMUstate(fmi2Component, fmi2FMUstate, fmi2Byte[], size_t);
SHOWN fmi2Status fmi2DeSerializeFMUstate(fmi2Component, const fmi2Byte[], size_t, fmi2FMUstate *);
SHOWN fmi2Status fmi2GetDirectionalDerivative(fmi2Component, const fmi2ValueReference unknown[], size_t,
                                              const fmi2ValueReference known[], size_t, const fmi2Real seed[],
                                              fmi2Real value[]);
SHOWN fmi2Status fmi2SetRealInputDerivatives(fmi2Component, const fmi2ValueReference[], size_t,
                                             const fmi2Integer order[], const fmi2Real[]);
SHOWN fmi2Status fmi2GetRealOutputDerivatives(fmi2Component, const fmi2ValueReference[], size_t,
                                              const fmi2Integer order[], fmi2Real[]);
SHOWN fmi2Status fmi2DoStep(fmi2Component, fmi2Real now, fmi2Real duration, fmi2Boolean no_way_back);
SHOWN fmi2Status fmi2CancelStep(fmi2Component);
SHOWN fmi2Status fmi2GetStatus(fmi2Component, const fmi2StatusKind, fmi2Status *);
SHOWN fmi2Status fmi2GetRealStatus(fmi2Component, const fmi2StatusKind, fmi2Real *);
SHOWN fmi2Status fmi2GetIntegerStatus(fmi2Component, const fmi2StatusKind, fmi2Integer *);
SHOWN fmi2Status fmi2GetBooleanStatus(fmi2Component, const fmi2StatusKind, fmi2Boolean *);
SHOWN fmi2Status fmi2GetStringStatus(fmi2Component, const fmi2StatusKind, fmi2String *);
#undef VALUES
