/* An emulated lidar by FMI 2.0 for co-simulation. The device is a process of its own, `python -m lidar_emu.fmu.worker`,
 * at the other end of a socket. Every wait has a limit, so that a process that died or hangs ends a step with
 * fmi2Error and a line in the log.
 *
 * config.h is written for each scenario. Variables with the value references 0 to LIDAR_GIVEN - 1 are set by the
 * simulator, those from LIDAR_GIVEN on by the lidar. */
#define _GNU_SOURCE
#include "config.h"
#include "fmi2Functions.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum {
    VARIABLES = LIDAR_GIVEN + LIDAR_MEASURED,
    START_LIMIT_S = 300, /* the first start on a machine compiles kernels for up to a minute */
    STEP_LIMIT_S = 60,
    LONGEST_PATH = 4096,
    LONGEST_TEXT = 1024
};

static const double start_values[VARIABLES] = {LIDAR_START_VALUES};

extern char **environ;

struct instance {
    char *name;
    char resources[LONGEST_PATH];
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
    int link; /* -1: no process */
    pid_t worker;
    int is_stepping;
    double values[VARIABLES];
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

static void stop(struct instance *self) {
    if (self->link < 0)
        return;
    close(self->link);
    self->link = -1;
    kill(self->worker, SIGKILL); /* it keeps nothing */
    while (waitpid(self->worker, NULL, 0) < 0 && errno == EINTR) {
    }
}

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Receive exactly so many bytes; 0, or a text that says why not. */
static const char *receive(const struct instance *self, void *data, size_t bytes, double until_s) {
    size_t have = 0;
    while (have < bytes) {
        struct pollfd link = {self->link, POLLIN, 0};
        double left_s = until_s - now_s();
        if (left_s <= 0)
            return "the lidar's process does not reply";
        if (poll(&link, 1, 1 + (int)(left_s * 1e3)) <= 0)
            continue;
        ssize_t got = recv(self->link, (char *)data + have, bytes - have, 0);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return "the lidar's process has ended";
        have += (size_t)got;
    }
    return NULL;
}

/* Receive a reply: so many bytes of values, or a text of the process. */
static fmi2Status reply(struct instance *self, void *values, size_t bytes, int limit_s) {
    uint32_t head[2];
    char text[LONGEST_TEXT] = "";
    double until_s = now_s() + limit_s;
    const char *trouble = receive(self, head, sizeof head, until_s);
    if (trouble == NULL && head[0] == 0 && head[1] == bytes)
        trouble = receive(self, values, bytes, until_s);
    else if (trouble == NULL && head[0] != 0 && head[1] < sizeof text) {
        trouble = receive(self, text, head[1], until_s);
        if (trouble == NULL)
            return failed(self, text);
    } else if (trouble == NULL)
        trouble = "the lidar's process is of another version";
    if (trouble == NULL)
        return fmi2OK;
    stop(self);
    return failed(self, trouble);
}

static fmi2Status start(struct instance *self) {
    char file[LONGEST_PATH + 16], python[LONGEST_PATH] = "";
    snprintf(file, sizeof file, "%s/python", self->resources);
    FILE *stored = fopen(file, "rb");
    if (stored == NULL)
        return failed(self, "the FMU's resources have no file python");
    size_t length = fread(python, 1, sizeof python - 1, stored);
    fclose(stored);
    python[length] = '\0';

    int pair[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0)
        return failed(self, "no socket for the lidar's process");
    /* -P: modules in the simulator's working directory do not replace those of Python. */
    char *arguments[] = {python, "-P", "-m", "lidar_emu.fmu.worker", self->resources, NULL};
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, pair[1], 0);
    posix_spawn_file_actions_adddup2(&actions, 2, 1); /* the simulator's standard output is its own */
    int error = posix_spawn(&self->worker, python, &actions, NULL, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    close(pair[1]);
    if (error != 0) {
        char text[LONGEST_PATH + 64];
        close(pair[0]);
        snprintf(text, sizeof text, "%s: %s", python, strerror(error));
        return failed(self, text);
    }
    self->link = pair[0];
    fmi2Status status = reply(self, NULL, 0, START_LIMIT_S);
    if (status != fmi2OK)
        stop(self);
    return status;
}

static int hexadecimal(char digit) {
    if (digit >= '0' && digit <= '9')
        return digit - '0';
    digit |= 0x20;
    return digit >= 'a' && digit <= 'f' ? digit - 'a' + 10 : -1;
}

/* Path of a URI file:/..., file:///... or file://localhost/...; 0 if there is none, or it is too long. */
static int path_of(const char *uri, char *path) {
    size_t length = 0;
    if (uri == NULL || strncmp(uri, "file:", 5) != 0)
        return 0;
    uri += 5;
    if (strncmp(uri, "//", 2) == 0 && (uri = strchr(uri + 2, '/')) == NULL)
        return 0;
    for (; *uri != '\0' && length < LONGEST_PATH - 1; uri++) {
        if (*uri == '%' && hexadecimal(uri[1]) >= 0 && hexadecimal(uri[2]) >= 0) {
            path[length++] = (char)(16 * hexadecimal(uri[1]) + hexadecimal(uri[2]));
            uri += 2;
        } else
            path[length++] = *uri;
    }
    path[length] = '\0';
    return *uri == '\0' && length > 0;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)visible;
    (void)logging; /* errors alone are logged, always */
    struct instance *self = calloc(1, sizeof *self);
    if (self == NULL)
        return NULL;
    self->link = -1;
    self->log = functions == NULL ? NULL : functions->logger;
    self->environment = functions == NULL ? NULL : functions->componentEnvironment;
    self->name = strdup(name == NULL ? "" : name);
    memcpy(self->values, start_values, sizeof start_values);
    const char *trouble = NULL;
    if (type != fmi2CoSimulation)
        trouble = "the FMU is for co-simulation";
    else if (guid == NULL || strcmp(guid, LIDAR_GUID) != 0)
        trouble = "the guid is that of another FMU";
    else if (!path_of(resources, self->resources))
        trouble = "the resource location is no URI of a local folder";
    if (trouble != NULL) {
        failed(self, trouble);
        fmi2FreeInstance(self);
        return NULL;
    }
    return self;
}

void fmi2FreeInstance(fmi2Component component) {
    struct instance *self = component;
    if (self == NULL)
        return;
    stop(self);
    free(self->name);
    free(self);
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real start_s, fmi2Boolean has_stop, fmi2Real stop_s) {
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop_s;
    return start_s >= 0 ? fmi2OK : failed(component, "the start time is before scenario time 0");
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    struct instance *self = component;
    stop(self);
    return start(self);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    struct instance *self = component;
    self->is_stepping = 1;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component component) {
    struct instance *self = component;
    stop(self);
    self->is_stepping = 0;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component) {
    struct instance *self = component;
    fmi2Terminate(self);
    memcpy(self->values, start_values, sizeof start_values);
    return fmi2OK;
}

/* The device receives the vehicle's state at the begin of the step, and returns what it has sent until then. */
fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time_s, fmi2Real step_s, fmi2Boolean no_return) {
    struct instance *self = component;
    double request[1 + LIDAR_GIVEN];
    (void)no_return;
    if (!self->is_stepping || self->link < 0)
        return failed(self, "no step: not initialised, or the lidar's process has ended; reset and initialise");
    if (!(step_s > 0))
        return failed(self, "the communication step is not above 0");
    request[0] = time_s;
    memcpy(request + 1, self->values, LIDAR_GIVEN * sizeof *request);
    ssize_t sent;
    do
        sent = send(self->link, request, sizeof request, MSG_NOSIGNAL);
    while (sent < 0 && errno == EINTR);
    if (sent != (ssize_t)sizeof request) {
        stop(self);
        return failed(self, "the lidar's process has ended");
    }
    return reply(self, self->values + LIDAR_GIVEN, LIDAR_MEASURED * sizeof *self->values, STEP_LIMIT_S);
}

#define GET(KIND, VALUE)                                                                                               \
    fmi2Status fmi2Get##KIND(fmi2Component component, const fmi2ValueReference numbers[], size_t count,              \
                             fmi2##KIND values[]) {                                                                    \
        const struct instance *self = component;                                                                       \
        for (size_t k = 0; k < count; k++) {                                                                           \
            if (numbers[k] >= VARIABLES)                                                                               \
                return failed(self, "unknown value reference");                                                       \
            values[k] = VALUE;                                                                                         \
        }                                                                                                              \
        return fmi2OK;                                                                                                 \
    }
#define SET(KIND, VALUE)                                                                                               \
    fmi2Status fmi2Set##KIND(fmi2Component component, const fmi2ValueReference numbers[], size_t count,              \
                             const fmi2##KIND values[]) {                                                              \
        struct instance *self = component;                                                                             \
        for (size_t k = 0; k < count; k++) {                                                                           \
            if (numbers[k] >= LIDAR_GIVEN)                                                                             \
                return failed(self, "only inputs and parameters can be set");                                         \
            self->values[numbers[k]] = VALUE;                                                                          \
        }                                                                                                              \
        return fmi2OK;                                                                                                 \
    }
GET(Real, self->values[numbers[k]])
GET(Integer, (fmi2Integer)self->values[numbers[k]])
GET(Boolean, self->values[numbers[k]] != 0)
SET(Real, values[k])
SET(Integer, values[k])
SET(Boolean, values[k] != 0)

/* What the description does not offer. */
static fmi2Status absent(fmi2Component component) { return failed(component, "the FMU does not offer this function"); }

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String categories[]) {
    (void)component, (void)on, (void)count, (void)categories;
    return fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference numbers[], size_t count,
                         fmi2String values[]) {
    (void)numbers, (void)values;
    return count == 0 ? fmi2OK : absent(component);
}
fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference numbers[], size_t count,
                         const fmi2String values[]) {
    (void)numbers, (void)values;
    return count == 0 ? fmi2OK : absent(component);
}
fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state) {
    (void)state;
    return absent(component);
}
fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state) {
    (void)state;
    return absent(component);
}
fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state) {
    (void)state;
    return absent(component);
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *bytes) {
    (void)state, (void)bytes;
    return absent(component);
}
fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte data[], size_t bytes) {
    (void)state, (void)data, (void)bytes;
    return absent(component);
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte data[], size_t bytes, fmi2FMUstate *state) {
    (void)data, (void)bytes, (void)state;
    return absent(component);
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real by[],
                                        fmi2Real values[]) {
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)by, (void)values;
    return absent(component);
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference numbers[], size_t count,
                                       const fmi2Integer orders[], const fmi2Real values[]) {
    (void)numbers, (void)count, (void)orders, (void)values;
    return absent(component);
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference numbers[], size_t count,
                                        const fmi2Integer orders[], fmi2Real values[]) {
    (void)numbers, (void)count, (void)orders, (void)values;
    return absent(component);
}
fmi2Status fmi2CancelStep(fmi2Component component) { return absent(component); }
fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return absent(component);
}
fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
    (void)kind, (void)value;
    return absent(component);
}
fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return absent(component);
}
fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value) {
    (void)kind, (void)value;
    return absent(component);
}
fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return absent(component);
}
