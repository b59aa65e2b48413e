/* The flight software: decodes what the lidar sends, solves, commands and reports. */
#ifndef FLIGHT_H
#define FLIGHT_H

#include "lidar.h"

typedef struct {
    lidar_receiver receiver;
    lidar_measurement measurement;
    bool has_shot;
    uint32_t next_shot, shots_lost;
    uint8_t sequence;
    unsigned packets_since_command; /* a command is pending if not 0 */
    uint64_t pending_command;
    bool is_standing_by, is_narrow_wanted, is_narrow;
} flight;

/* Take a byte from the lidar. */
void flight_receive(flight *self, uint8_t byte);

#endif
