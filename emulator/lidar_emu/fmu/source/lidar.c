/* The device is a process of its own, `python -m lidar_emu.fmu.worker`, at the other end of a socket. Every wait has a
 * limit, so that a process that died or hangs ends a step with an error. */
#define _GNU_SOURCE
#include "lidar.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum {
    START_LIMIT_S = 300, /* the first start on a machine compiles kernels for up to a minute */
    STEP_LIMIT_S = 60
};

const struct place lidar_places[LIDAR_PLACES] = {LIDAR_TABLE};

extern char **environ;

const char *lidar_create(struct lidar *self, const char *token, const char *resources) {
    self->link = -1;
    lidar_reset(self);
    if (token == NULL || strcmp(token, LIDAR_TOKEN) != 0)
        return "the model description is that of another FMU";
    if (resources == NULL || strlen(resources) >= LONGEST_PATH)
        return "the resource location is no local folder";
    strcpy(self->resources, resources);
    return NULL;
}

void lidar_release(struct lidar *self) {
    lidar_stop(self);
    free(self->sent);
}

void lidar_reset(struct lidar *self) {
    lidar_stop(self);
    for (size_t place = 0; place < LIDAR_PLACES; place++)
        self->values[place] = lidar_places[place].start;
    self->sent_bytes = 0;
}

const char *lidar_check(struct lidar *self, const uint32_t numbers[], size_t count, size_t value_count, enum kind kind,
                        uint32_t end) {
    size_t needed = 0;
    for (size_t k = 0; k < count; k++) {
        uint32_t number = numbers[k];
        const char *trouble = NULL;
        if (number >= LIDAR_PLACES || lidar_places[number].size == 0 || lidar_places[number].kind != kind)
            trouble = "there is no such variable of this type";
        else if (number >= end)
            trouble = "only inputs and parameters can be set";
        if (trouble != NULL) {
            snprintf(self->trouble, sizeof self->trouble, "value reference %u: %s", (unsigned)number, trouble);
            return self->trouble;
        }
        needed += lidar_places[number].size;
    }
    if (needed == value_count)
        return NULL;
    snprintf(self->trouble, sizeof self->trouble, "%zu values for variables that have %zu", value_count, needed);
    return self->trouble;
}

void lidar_stop(struct lidar *self) {
    self->is_stepping = 0;
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

/* Receive exactly `size` bytes. */
static const char *receive(const struct lidar *self, void *data, size_t size, double until_s) {
    size_t have = 0;
    while (have < size) {
        struct pollfd link = {self->link, POLLIN, 0};
        double left_s = until_s - now_s();
        if (left_s <= 0)
            return "the lidar's process does not reply";
        if (poll(&link, 1, 1 + (int)(left_s * 1e3)) <= 0)
            continue;
        ssize_t got = recv(self->link, (char *)data + have, size - have, 0);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return "the lidar's process has ended";
        have += (size_t)got;
    }
    return NULL;
}

/* Receive values, and the bytes that were sent. */
static const char *receive_step(struct lidar *self, size_t bytes, double *values, size_t value_bytes, double until_s) {
    if (bytes < value_bytes)
        return "the lidar's process is of another version";
    const char *trouble = receive(self, values, value_bytes, until_s);
    size_t sent_bytes = bytes - value_bytes;
    if (trouble != NULL || sent_bytes == 0)
        return trouble;
    uint8_t *sent = realloc(self->sent, sent_bytes);
    if (sent == NULL)
        return "no memory for what the lidar has sent";
    self->sent = sent;
    trouble = receive(self, sent, sent_bytes, until_s);
    if (trouble == NULL)
        self->sent_bytes = sent_bytes;
    return trouble;
}

/* Receive a reply: values and bytes, or a text. The process goes on after a text alone. */
static const char *reply(struct lidar *self, double *values, size_t value_bytes, int limit_s) {
    uint32_t head[2];
    double until_s = now_s() + limit_s;
    self->sent_bytes = 0;
    const char *trouble = receive(self, head, sizeof head, until_s);
    if (trouble == NULL && head[0] == 0)
        trouble = receive_step(self, head[1], values, value_bytes, until_s);
    else if (trouble == NULL && head[1] < sizeof self->trouble) {
        trouble = receive(self, self->trouble, head[1], until_s);
        self->trouble[head[1]] = '\0';
        if (trouble == NULL)
            return self->trouble;
    } else if (trouble == NULL)
        trouble = "the lidar's process is of another version";
    if (trouble != NULL)
        lidar_stop(self);
    return trouble;
}

const char *lidar_start(struct lidar *self) {
    char file[LONGEST_PATH + 16], python[LONGEST_PATH] = "";
    lidar_stop(self);
    snprintf(file, sizeof file, "%s/python", self->resources);
    FILE *stored = fopen(file, "rb");
    if (stored == NULL)
        return "the FMU's resources have no file python";
    size_t length = fread(python, 1, sizeof python - 1, stored);
    fclose(stored);
    python[length] = '\0';

    int pair[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0)
        return "no socket for the lidar's process";
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
        close(pair[0]);
        snprintf(self->trouble, sizeof self->trouble, "%.900s: %s", python, strerror(error));
        return self->trouble;
    }
    self->link = pair[0];
    const char *trouble = reply(self, NULL, 0, START_LIMIT_S);
    if (trouble != NULL)
        lidar_stop(self);
    return trouble;
}

const char *lidar_check_start_time(double start_s) {
    return start_s >= 0 ? NULL : "the start time is before scenario time 0";
}

void lidar_begin_steps(struct lidar *self) { self->is_stepping = 1; }

const char *lidar_step(struct lidar *self, double time_s, double step_s) {
    double request[1 + LIDAR_GIVEN];
    if (!self->is_stepping || self->link < 0)
        return "no step: not initialised, or the lidar's process has ended; reset and initialise";
    if (!(step_s > 0))
        return "the communication step is not above 0";
    request[0] = time_s;
    memcpy(request + 1, self->values, LIDAR_GIVEN * sizeof *request);
    ssize_t sent;
    do
        sent = send(self->link, request, sizeof request, MSG_NOSIGNAL);
    while (sent < 0 && errno == EINTR);
    if (sent != (ssize_t)sizeof request) {
        lidar_stop(self);
        return "the lidar's process has ended";
    }
    return reply(self, self->values + LIDAR_GIVEN, LIDAR_MEASURED * sizeof *self->values, STEP_LIMIT_S);
}
