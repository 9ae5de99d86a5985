/* A lane keeper as an FMU for co-simulation: FMI 2.0, or FMI 3.0 with -DFMI=3.
 *
 * It steers by the road's curvature, the heading error and the offset from the lane's centre, with a
 * first-order lag. Its front wheels turn by at most `limit`: in tighter bends it leaves the lane.
 *
 * Another law may stand in a file of its own: -DLAW='"law.h"'. The file defines
 * `static int law(Model *model, double time, double step)`, which returns a status of FMI.
 */
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef FMI
#define FMI 2
#endif
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
/* Value references of modelDescription.xml. */
enum {
    OFFSET, HEADING_ERROR, CURVATURE, SPEED, STEERING,
    GAIN, WHEELBASE, LIMIT, LAG, HEADING_GAIN, COUNT
};

static const double START[COUNT] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 2.7, 8.0, 0.05, 0.4};
static const double DEGREES = 57.29577951308232;

#if FMI == 2
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *finished;
    void *environment;
} Callbacks;
#else
typedef void (*Logger)(void *, int, const char *, const char *);
#endif

typedef struct {
    double values[COUNT];
    Logger log;
    void *environment;
} Model;

static void say(Model *model, int status, const char *message) {
    if (model->log == NULL) return;
#if FMI == 2
    model->log(model->environment, "lane_keeper", status, "logStatusError", "%s", message);
#else
    model->log(model->environment, status, "logStatusError", message);
#endif
}

#ifdef LAW
#include LAW
#else
static int law(Model *model, double time, double step) {
    double *v = model->values;
    double wanted = atan(v[WHEELBASE] * v[CURVATURE]) - v[HEADING_GAIN] * v[HEADING_ERROR]
                    - atan(v[GAIN] * v[OFFSET] / (v[SPEED] + 2.0));
    double limit = v[LIMIT] / DEGREES, share = v[LAG] > 0.0 ? 1.0 - exp(-step / v[LAG]) : 1.0;
    (void)time;
    if (v[LAG] < 0.0) {
        say(model, ERROR, "the lag is negative");
        return ERROR;
    }
    wanted = fmin(fmax(wanted, -limit), limit) * DEGREES;
    v[STEERING] += share * (wanted - v[STEERING]);
    return OK;
}
#endif

/* Set or get `size` values of `n` variables; a single variable may be an array. */
static int pass_values(Model *model, const uint32_t *references, size_t n, double *into,
                       const double *from, size_t size) {
    if (n != 1 && n != size) return ERROR;
    for (size_t i = 0; i < size; i++) {
        size_t place = n == 1 ? references[0] + i : references[i];
        if (place >= COUNT) return ERROR;
        if (into != NULL) into[i] = model->values[place];
        else model->values[place] = from[i];
    }
    return OK;
}

static int reset(Model *model) {
    memcpy(model->values, START, sizeof START);
    return OK;
}

static Model *new_model(Logger log, void *environment) {
    Model *model = calloc(1, sizeof(Model));
    if (model == NULL) return NULL;
    model->log = log;
    model->environment = environment;
    reset(model);
    return model;
}

/* Functions that a lane keeper does not need: FMI asks for them, with any arguments. */
#define ABSENT(name) EXPORT int name(void) { return ERROR; }
#define DONE(name) EXPORT int name(void) { return OK; }

#if FMI == 2

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                             const Callbacks *callbacks, int visible, int logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    return new_model(callbacks->log, callbacks->environment);
}
EXPORT void fmi2FreeInstance(void *model) { free(model); }
EXPORT int fmi2Reset(void *model) { return reset(model); }
EXPORT int fmi2SetReal(void *model, const uint32_t *references, size_t n, const double *values) {
    return pass_values(model, references, n, NULL, values, n);
}
EXPORT int fmi2GetReal(void *model, const uint32_t *references, size_t n, double *values) {
    return pass_values(model, references, n, values, NULL, n);
}
EXPORT int fmi2DoStep(void *model, double time, double step, int keeps_state) {
    (void)keeps_state;
    return law(model, time, step);
}
DONE(fmi2SetDebugLogging)
DONE(fmi2SetupExperiment)
DONE(fmi2EnterInitializationMode)
DONE(fmi2ExitInitializationMode)
DONE(fmi2Terminate)
ABSENT(fmi2GetInteger)
ABSENT(fmi2GetBoolean)
ABSENT(fmi2GetString)
ABSENT(fmi2SetInteger)
ABSENT(fmi2SetBoolean)
ABSENT(fmi2SetString)
ABSENT(fmi2GetFMUstate)
ABSENT(fmi2SetFMUstate)
ABSENT(fmi2FreeFMUstate)
ABSENT(fmi2SerializedFMUstateSize)
ABSENT(fmi2SerializeFMUstate)
ABSENT(fmi2DeSerializeFMUstate)
ABSENT(fmi2GetDirectionalDerivative)
ABSENT(fmi2SetRealInputDerivatives)
ABSENT(fmi2GetRealOutputDerivatives)
ABSENT(fmi2CancelStep)
ABSENT(fmi2GetStatus)
ABSENT(fmi2GetRealStatus)
ABSENT(fmi2GetIntegerStatus)
ABSENT(fmi2GetBooleanStatus)
ABSENT(fmi2GetStringStatus)

#else

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                         _Bool visible, _Bool logging, _Bool events, _Bool early,
                                         const uint32_t *required, size_t n, void *environment,
                                         Logger log, void *update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events;
    (void)early, (void)required, (void)n, (void)update;
    return new_model(log, environment);
}
EXPORT void fmi3FreeInstance(void *model) { free(model); }
EXPORT int fmi3Reset(void *model) { return reset(model); }
EXPORT int fmi3SetFloat64(void *model, const uint32_t *references, size_t n, const double *values,
                          size_t size) {
    return pass_values(model, references, n, NULL, values, size);
}
EXPORT int fmi3GetFloat64(void *model, const uint32_t *references, size_t n, double *values,
                          size_t size) {
    return pass_values(model, references, n, values, NULL, size);
}
EXPORT int fmi3DoStep(void *model, double time, double step, _Bool keeps_state, _Bool *has_event,
                      _Bool *ends, _Bool *returns_early, double *last_time) {
    (void)keeps_state;
    *has_event = *ends = *returns_early = 0;
    *last_time = time + step;
    return law(model, time, step);
}
DONE(fmi3SetDebugLogging)
DONE(fmi3EnterInitializationMode)
DONE(fmi3ExitInitializationMode)
DONE(fmi3Terminate)
#define ABSENT_TYPE(type) ABSENT(fmi3Get##type) ABSENT(fmi3Set##type)
ABSENT_TYPE(Float32)
ABSENT_TYPE(Int8)
ABSENT_TYPE(UInt8)
ABSENT_TYPE(Int16)
ABSENT_TYPE(UInt16)
ABSENT_TYPE(Int32)
ABSENT_TYPE(UInt32)
ABSENT_TYPE(Int64)
ABSENT_TYPE(UInt64)
ABSENT_TYPE(Boolean)
ABSENT_TYPE(String)
ABSENT_TYPE(Binary)
ABSENT_TYPE(Clock)
ABSENT_TYPE(FMUState)
ABSENT_TYPE(IntervalDecimal)
ABSENT_TYPE(IntervalFraction)
ABSENT_TYPE(ShiftDecimal)
ABSENT_TYPE(ShiftFraction)
ABSENT(fmi3InstantiateModelExchange)
ABSENT(fmi3InstantiateScheduledExecution)
ABSENT(fmi3EnterEventMode)
ABSENT(fmi3GetNumberOfVariableDependencies)
ABSENT(fmi3GetVariableDependencies)
ABSENT(fmi3FreeFMUState)
ABSENT(fmi3SerializedFMUStateSize)
ABSENT(fmi3SerializeFMUState)
ABSENT(fmi3DeserializeFMUState)
ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetAdjointDerivative)
ABSENT(fmi3EnterConfigurationMode)
ABSENT(fmi3ExitConfigurationMode)
ABSENT(fmi3EvaluateDiscreteStates)
ABSENT(fmi3UpdateDiscreteStates)
ABSENT(fmi3EnterContinuousTimeMode)
ABSENT(fmi3CompletedIntegratorStep)
ABSENT(fmi3SetTime)
ABSENT(fmi3SetContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives)
ABSENT(fmi3GetEventIndicators)
ABSENT(fmi3GetContinuousStates)
ABSENT(fmi3GetNominalsOfContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates)
ABSENT(fmi3EnterStepMode)
ABSENT(fmi3GetOutputDerivatives)
ABSENT(fmi3ActivateModelPartition)

#endif
