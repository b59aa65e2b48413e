/* An emulated lidar by FMI 2.0 for co-simulation. */
#define _GNU_SOURCE
#include "fmi2Functions.h"
#include "lidar.h"

#include <stdlib.h>
#include <string.h>

struct instance {
    struct lidar lidar;
    char *name;
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
};

/* Log a text as the format itself, since some simulators show the format and no arguments. */
static fmi2Status failed(const struct instance *self, const char *text) {
    char format[2 * LONGEST_TEXT];
    size_t length = 0;
    for (; *text != '\0' && length < sizeof format - 2; text++) {
        if (*text == '%')
            format[length++] = '%';
        format[length++] = *text;
    }
    format[length] = '\0';
    if (self->log != NULL)
        self->log(self->environment, self->name, fmi2Error, "logStatusError", format);
    return fmi2Error;
}

static fmi2Status finished(const struct instance *self, const char *trouble) {
    return trouble == NULL ? fmi2OK : failed(self, trouble);
}

static int hexadecimal(char digit) {
    if (digit >= '0' && digit <= '9')
        return digit - '0';
    digit |= 0x20;
    return digit >= 'a' && digit <= 'f' ? digit - 'a' + 10 : -1;
}

/* Path of a URI file:/..., file:///... or file://localhost/...; NULL if there is none, or it is too long. */
static const char *path_of(const char *uri, char path[LONGEST_PATH]) {
    size_t length = 0;
    if (uri == NULL || strncmp(uri, "file:", 5) != 0)
        return NULL;
    uri += 5;
    if (strncmp(uri, "//", 2) == 0 && (uri = strchr(uri + 2, '/')) == NULL)
        return NULL;
    for (; *uri != '\0' && length < LONGEST_PATH - 1; uri++) {
        if (*uri == '%' && hexadecimal(uri[1]) >= 0 && hexadecimal(uri[2]) >= 0) {
            path[length++] = (char)(16 * hexadecimal(uri[1]) + hexadecimal(uri[2]));
            uri += 2;
        } else
            path[length++] = *uri;
    }
    path[length] = '\0';
    return *uri == '\0' && length > 0 ? path : NULL;
}

static void release(struct instance *self) {
    lidar_release(&self->lidar);
    free(self->name);
    free(self);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

/* Errors alone are logged, always. */
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    char path[LONGEST_PATH];
    struct instance *self = calloc(1, sizeof *self);
    if (self == NULL)
        return NULL;
    self->log = functions == NULL ? NULL : functions->logger;
    self->environment = functions == NULL ? NULL : functions->componentEnvironment;
    self->name = strdup(name == NULL ? "" : name);
    const char *trouble = lidar_create(&self->lidar, guid, path_of(resources, path));
    if (type != fmi2CoSimulation)
        trouble = "the FMU is for co-simulation";
    if (trouble != NULL) {
        failed(self, trouble);
        release(self);
        return NULL;
    }
    return self;
}

void fmi2FreeInstance(fmi2Component component) {
    if (component != NULL)
        release(component);
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String categories[]) {
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real start_s, fmi2Boolean has_stop, fmi2Real stop_s) {
    return finished(component, lidar_check_start_time(start_s));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    struct instance *self = component;
    return finished(self, lidar_start(&self->lidar));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    struct instance *self = component;
    lidar_begin_steps(&self->lidar);
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component component) {
    struct instance *self = component;
    lidar_stop(&self->lidar);
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component) {
    struct instance *self = component;
    lidar_reset(&self->lidar);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time_s, fmi2Real step_s, fmi2Boolean no_return) {
    struct instance *self = component;
    return finished(self, lidar_step(&self->lidar, time_s, step_s));
}

#define GET(TYPE, KIND)                                                                                                \
    fmi2Status fmi2Get##TYPE(fmi2Component component, const fmi2ValueReference numbers[], size_t count,                \
                             fmi2##TYPE values[]) {                                                                    \
        struct instance *self = component;                                                                             \
        const char *trouble = lidar_check(&self->lidar, numbers, count, count, KIND, LIDAR_PLACES);                    \
        for (size_t k = 0; trouble == NULL && k < count; k++)                                                          \
            values[k] = (fmi2##TYPE)self->lidar.values[numbers[k]];                                                    \
        return finished(self, trouble);                                                                                \
    }
#define SET(TYPE, KIND)                                                                                                \
    fmi2Status fmi2Set##TYPE(fmi2Component component, const fmi2ValueReference numbers[], size_t count,                \
                             const fmi2##TYPE values[]) {                                                              \
        struct instance *self = component;                                                                             \
        const char *trouble = lidar_check(&self->lidar, numbers, count, count, KIND, LIDAR_GIVEN);                     \
        for (size_t k = 0; trouble == NULL && k < count; k++)                                                          \
            self->lidar.values[numbers[k]] = KIND == BOOLEAN ? values[k] != 0 : values[k];                             \
        return finished(self, trouble);                                                                                \
    }
GET(Real, REAL)
GET(Integer, INTEGER)
GET(Boolean, BOOLEAN)
SET(Real, REAL)
SET(Integer, INTEGER)
SET(Boolean, BOOLEAN)

/* No variable is a string. */
fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference numbers[], size_t count,
                         fmi2String values[]) {
    struct instance *self = component;
    return finished(self, lidar_check(&self->lidar, numbers, count, count, NONE, LIDAR_PLACES));
}
fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference numbers[], size_t count,
                         const fmi2String values[]) {
    struct instance *self = component;
    return finished(self, lidar_check(&self->lidar, numbers, count, count, NONE, LIDAR_GIVEN));
}

/* What the description does not offer. */
#define ABSENT(NAME, ...)                                                                                              \
    fmi2Status fmi2##NAME(fmi2Component component, ##__VA_ARGS__) {                                                    \
        return failed(component, "the FMU does not offer fmi2" #NAME);                                                 \
    }
ABSENT(GetFMUstate, fmi2FMUstate *state)
ABSENT(SetFMUstate, fmi2FMUstate state)
ABSENT(FreeFMUstate, fmi2FMUstate *state)
ABSENT(SerializedFMUstateSize, fmi2FMUstate state, size_t *bytes)
ABSENT(SerializeFMUstate, fmi2FMUstate state, fmi2Byte data[], size_t bytes)
ABSENT(DeSerializeFMUstate, const fmi2Byte data[], size_t bytes, fmi2FMUstate *state)
ABSENT(GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t unknowns, const fmi2ValueReference known[],
       size_t knowns, const fmi2Real by[], fmi2Real values[])
ABSENT(SetRealInputDerivatives, const fmi2ValueReference numbers[], size_t count, const fmi2Integer orders[],
       const fmi2Real values[])
ABSENT(GetRealOutputDerivatives, const fmi2ValueReference numbers[], size_t count, const fmi2Integer orders[],
       fmi2Real values[])
ABSENT(CancelStep)
ABSENT(GetStatus, const fmi2StatusKind kind, fmi2Status *value)
ABSENT(GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
ABSENT(GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
ABSENT(GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
ABSENT(GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

/* Model exchange: some importers load these functions for co-simulation too. */
ABSENT(EnterEventMode)
ABSENT(NewDiscreteStates, fmi2EventInfo *info)
ABSENT(EnterContinuousTimeMode)
ABSENT(CompletedIntegratorStep, fmi2Boolean no_return, fmi2Boolean *event, fmi2Boolean *terminate)
ABSENT(SetTime, fmi2Real time_s)
ABSENT(SetContinuousStates, const fmi2Real states[], size_t count)
ABSENT(GetDerivatives, fmi2Real derivatives[], size_t count)
ABSENT(GetEventIndicators, fmi2Real indicators[], size_t count)
ABSENT(GetContinuousStates, fmi2Real states[], size_t count)
ABSENT(GetNominalsOfContinuousStates, fmi2Real nominals[], size_t count)
