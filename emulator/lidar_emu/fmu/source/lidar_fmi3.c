/* An emulated lidar by FMI 3.0 for co-simulation. */
#include "fmi3Functions.h"
#include "lidar.h"

#include <stdlib.h>

enum { TIME = LIDAR_GIVEN + LIDAR_MEASURED }; /* place of the independent variable */

struct instance {
    struct lidar lidar;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
};

static fmi3Status failed(const struct instance *self, const char *text) {
    if (self->log != NULL)
        self->log(self->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

static fmi3Status finished(const struct instance *self, const char *trouble) {
    return trouble == NULL ? fmi3OK : failed(self, trouble);
}

static void release(struct instance *self) {
    lidar_release(&self->lidar);
    free(self);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

/* Errors alone are logged, always. */
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t intermediates,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    struct instance *self = calloc(1, sizeof *self);
    if (self == NULL)
        return NULL;
    self->log = log;
    self->environment = environment;
    const char *trouble = lidar_create(&self->lidar, token, resources);
    if (event_mode)
        trouble = "the FMU has no event mode";
    else if (intermediates != 0)
        trouble = "the FMU has no intermediate update";
    if (trouble != NULL) {
        failed(self, trouble);
        release(self);
        return NULL;
    }
    return self;
}

static fmi3Instance not_offered(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    const struct instance none = {.log = log, .environment = environment};
    failed(&none, "the FMU is for co-simulation");
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    return not_offered(environment, log);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    return not_offered(environment, log);
}

void fmi3FreeInstance(fmi3Instance instance) {
    if (instance != NULL)
        release(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count, const fmi3String categories[]) {
    return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerance,
                                       fmi3Float64 start_s, fmi3Boolean has_stop, fmi3Float64 stop_s) {
    struct instance *self = instance;
    const char *trouble = lidar_check_start_time(start_s);
    if (trouble == NULL)
        trouble = lidar_start(&self->lidar);
    if (trouble == NULL)
        self->lidar.values[TIME] = start_s;
    return finished(self, trouble);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    struct instance *self = instance;
    lidar_begin_steps(&self->lidar);
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    struct instance *self = instance;
    lidar_stop(&self->lidar);
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    struct instance *self = instance;
    lidar_reset(&self->lidar);
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time_s, fmi3Float64 step_s, fmi3Boolean no_return,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early_return, fmi3Float64 *reached_s) {
    struct instance *self = instance;
    *event = *terminate = *early_return = fmi3False;
    *reached_s = time_s;
    const char *trouble = lidar_step(&self->lidar, time_s, step_s);
    if (trouble == NULL)
        *reached_s = self->lidar.values[TIME] = time_s + step_s;
    return finished(self, trouble);
}

#define GET(TYPE, KIND)                                                                                                \
    fmi3Status fmi3Get##TYPE(fmi3Instance instance, const fmi3ValueReference numbers[], size_t count,                  \
                             fmi3##TYPE values[], size_t value_count) {                                                \
        struct instance *self = instance;                                                                              \
        const char *trouble = lidar_check(&self->lidar, numbers, count, value_count, KIND, LIDAR_PLACES);              \
        for (size_t k = 0; trouble == NULL && k < count; k++)                                                          \
            for (uint32_t element = 0; element < lidar_places[numbers[k]].size; element++)                             \
                *values++ = (fmi3##TYPE)self->lidar.values[numbers[k] + element];                                      \
        return finished(self, trouble);                                                                                \
    }
#define SET(TYPE, KIND)                                                                                                \
    fmi3Status fmi3Set##TYPE(fmi3Instance instance, const fmi3ValueReference numbers[], size_t count,                  \
                             const fmi3##TYPE values[], size_t value_count) {                                          \
        struct instance *self = instance;                                                                              \
        const char *trouble = lidar_check(&self->lidar, numbers, count, value_count, KIND, LIDAR_GIVEN);               \
        for (size_t k = 0; trouble == NULL && k < count; k++)                                                          \
            for (uint32_t element = 0; element < lidar_places[numbers[k]].size; element++)                             \
                self->lidar.values[numbers[k] + element] = (double)*values++;                                          \
        return finished(self, trouble);                                                                                \
    }
#define GET_AND_SET(TYPE, KIND) GET(TYPE, KIND) SET(TYPE, KIND)
GET_AND_SET(Float64, REAL)
GET_AND_SET(Int64, INTEGER)
GET_AND_SET(Boolean, BOOLEAN)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference numbers[], size_t count, size_t sizes[],
                         fmi3Binary values[], size_t value_count) {
    struct instance *self = instance;
    const char *trouble = lidar_check(&self->lidar, numbers, count, value_count, BYTES, LIDAR_PLACES);
    for (size_t k = 0; trouble == NULL && k < count; k++) {
        sizes[k] = self->lidar.sent_bytes;
        values[k] = self->lidar.sent_bytes > 0 ? self->lidar.sent : (fmi3Binary) "";
    }
    return finished(self, trouble);
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference numbers[], size_t count, const size_t sizes[],
                         const fmi3Binary values[], size_t value_count) {
    struct instance *self = instance;
    return finished(self, lidar_check(&self->lidar, numbers, count, value_count, BYTES, LIDAR_GIVEN));
}

/* Types that no variable has. */
GET_AND_SET(Float32, NONE)
GET_AND_SET(Int8, NONE)
GET_AND_SET(UInt8, NONE)
GET_AND_SET(Int16, NONE)
GET_AND_SET(UInt16, NONE)
GET_AND_SET(Int32, NONE)
GET_AND_SET(UInt32, NONE)
GET_AND_SET(UInt64, NONE)

#define NO_VARIABLES(FUNCTION, VALUE, ...)                                                                             \
    fmi3Status fmi3##FUNCTION(fmi3Instance instance, const fmi3ValueReference numbers[], size_t count, VALUE values[], \
                              ##__VA_ARGS__) {                                                                         \
        struct instance *self = instance;                                                                              \
        return finished(self, lidar_check(&self->lidar, numbers, count, 0, NONE, LIDAR_PLACES));                       \
    }
NO_VARIABLES(GetString, fmi3String, size_t value_count)
NO_VARIABLES(SetString, const fmi3String, size_t value_count)
NO_VARIABLES(GetClock, fmi3Clock)
NO_VARIABLES(SetClock, const fmi3Clock)

/* What the description does not offer. */
#define ABSENT(NAME, ...)                                                                                              \
    fmi3Status fmi3##NAME(fmi3Instance instance, ##__VA_ARGS__) {                                                      \
        return failed(instance, "the FMU does not offer fmi3" #NAME);                                                  \
    }
ABSENT(GetNumberOfVariableDependencies, fmi3ValueReference number, size_t *count)
ABSENT(GetVariableDependencies, fmi3ValueReference number, size_t elements[], fmi3ValueReference independents[],
       size_t of_independents[], fmi3DependencyKind kinds[], size_t count)
ABSENT(GetFMUState, fmi3FMUState *state)
ABSENT(SetFMUState, fmi3FMUState state)
ABSENT(FreeFMUState, fmi3FMUState *state)
ABSENT(SerializedFMUStateSize, fmi3FMUState state, size_t *bytes)
ABSENT(SerializeFMUState, fmi3FMUState state, fmi3Byte data[], size_t bytes)
ABSENT(DeserializeFMUState, const fmi3Byte data[], size_t bytes, fmi3FMUState *state)
ABSENT(GetDirectionalDerivative, const fmi3ValueReference unknowns[], size_t unknown_count,
       const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[], size_t seeds,
       fmi3Float64 values[], size_t value_count)
ABSENT(GetAdjointDerivative, const fmi3ValueReference unknowns[], size_t unknown_count,
       const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[], size_t seeds,
       fmi3Float64 values[], size_t value_count)
ABSENT(GetOutputDerivatives, const fmi3ValueReference numbers[], size_t count, const fmi3Int32 orders[],
       fmi3Float64 values[], size_t value_count)
ABSENT(EnterConfigurationMode)
ABSENT(ExitConfigurationMode)
ABSENT(EnterEventMode)
ABSENT(EnterStepMode)
ABSENT(EvaluateDiscreteStates)
ABSENT(UpdateDiscreteStates, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values,
       fmi3Boolean *is_time_defined, fmi3Float64 *time_s)

/* Clocks. */
ABSENT(GetIntervalDecimal, const fmi3ValueReference numbers[], size_t count, fmi3Float64 intervals[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(GetIntervalFraction, const fmi3ValueReference numbers[], size_t count, fmi3UInt64 counters[],
       fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
ABSENT(GetShiftDecimal, const fmi3ValueReference numbers[], size_t count, fmi3Float64 shifts[])
ABSENT(GetShiftFraction, const fmi3ValueReference numbers[], size_t count, fmi3UInt64 counters[],
       fmi3UInt64 resolutions[])
ABSENT(SetIntervalDecimal, const fmi3ValueReference numbers[], size_t count, const fmi3Float64 intervals[])
ABSENT(SetIntervalFraction, const fmi3ValueReference numbers[], size_t count, const fmi3UInt64 counters[],
       const fmi3UInt64 resolutions[])
ABSENT(SetShiftDecimal, const fmi3ValueReference numbers[], size_t count, const fmi3Float64 shifts[])
ABSENT(SetShiftFraction, const fmi3ValueReference numbers[], size_t count, const fmi3UInt64 counters[],
       const fmi3UInt64 resolutions[])
ABSENT(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time_s)

/* Model exchange. */
ABSENT(EnterContinuousTimeMode)
ABSENT(CompletedIntegratorStep, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate)
ABSENT(SetTime, fmi3Float64 time_s)
ABSENT(SetContinuousStates, const fmi3Float64 states[], size_t count)
ABSENT(GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t count)
ABSENT(GetEventIndicators, fmi3Float64 indicators[], size_t count)
ABSENT(GetContinuousStates, fmi3Float64 states[], size_t count)
ABSENT(GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t count)
ABSENT(GetNumberOfEventIndicators, size_t *count)
ABSENT(GetNumberOfContinuousStates, size_t *count)
