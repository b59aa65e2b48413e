/* The lidar behind an FMU, for every version of FMI: its variables, and the process that measures.
 *
 * Functions that can fail return NULL, or a text that says why, valid until the next call for the same lidar. */
#ifndef LIDAR_H
#define LIDAR_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

enum kind { NONE, REAL, INTEGER, BOOLEAN, BYTES };

/* A variable's values have consecutive places; its value reference is the first. Places below LIDAR_GIVEN are set by the
 * simulator, the next LIDAR_MEASURED by the lidar. */
struct place {
    enum kind kind;
    uint32_t size; /* values of the variable that begins here; 0 within an array */
    double start;
};

#include "config.h" /* written for each FMU */

enum { LONGEST_PATH = 4096, LONGEST_TEXT = 1024 };

struct lidar {
    char resources[LONGEST_PATH];
    int link; /* socket to the process; -1: no process */
    pid_t worker;
    int is_stepping;
    double values[LIDAR_PLACES];
    uint8_t *sent; /* what the device sent in the newest step, as on a serial line */
    size_t sent_bytes;
    char trouble[LONGEST_TEXT];
};

extern const struct place lidar_places[LIDAR_PLACES];

/* Set up a lidar in memory that is all 0. Always followed by lidar_release, even if it fails. */
const char *lidar_create(struct lidar *self, const char *token, const char *resources);
void lidar_release(struct lidar *self);

/* Check value references of variables of one kind, below the place `end`, that have value_count values together. */
const char *lidar_check(struct lidar *self, const uint32_t numbers[], size_t count, size_t value_count, enum kind kind,
                        uint32_t end);

/* Start the process. */
const char *lidar_start(struct lidar *self);
const char *lidar_check_start_time(double start_s);
void lidar_begin_steps(struct lidar *self);

/* The device receives the vehicle's state at the beginning of the step, and returns what it has sent until then. */
const char *lidar_step(struct lidar *self, double time_s, double step_s);

/* End the process. */
void lidar_stop(struct lidar *self);

/* End the process, and set all variables to their start values. */
void lidar_reset(struct lidar *self);

#endif
