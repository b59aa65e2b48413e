/* The flight software: solves what the lidar measures, commands and reports. */
#ifndef FLIGHT_H
#define FLIGHT_H

#include "lidar.h"

typedef struct {
    bool has_shot;
    uint32_t next_shot, shots_lost;
    uint8_t sequence, solutions;
    unsigned messages_since_command; /* a command is pending if not 0 */
    uint64_t pending_command;
    bool is_standing_by, is_narrow_wanted, is_narrow;
} flight;

/* Messages from the lidar, in the order of their arrival: a measurement, an acknowledgement, the mode in housekeeping. */
void flight_take_measurement(flight *self, const lidar_measurement *measurement);
void flight_take_acknowledge(flight *self, uint64_t command, uint64_t sequence, uint64_t verdict);
void flight_take_mode(flight *self, uint64_t mode);

#endif
