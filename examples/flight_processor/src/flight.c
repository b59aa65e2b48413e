#include "flight.h"
#include "board.h"
#include "navigation.h"
#include "report.h"

enum { UNIT = 0, BEAMS = 4, NARROW_PATTERN = 1, PACKETS_UNTIL_REPEATED = 5 };
static const lidar_real narrow_below_m = (lidar_real)500;

/* ------------------------------------------------------------------------------------------------- commands */

/* Send the command that is needed next. While one is pending it is repeated with its own number: it or its answer may be lost. */
static void command(flight *self) {
    uint8_t frame[LIDAR_LONGEST_COMMAND];
    size_t length;
    if (self->packets_since_command != 0u && self->packets_since_command++ < PACKETS_UNTIL_REPEATED)
        return;
    if (self->is_standing_by) {
        self->pending_command = LIDAR_COMMAND_SET_MODE;
        length = lidar_encode_set_mode(frame, UNIT, self->sequence, LIDAR_MODE_TRACK);
    } else if (self->is_narrow_wanted && !self->is_narrow) {
        self->pending_command = LIDAR_COMMAND_SET_PATTERN;
        length = lidar_encode_set_pattern(frame, UNIT, self->sequence, NARROW_PATTERN);
    } else {
        return;
    }
    self->packets_since_command = 1u;
    board_write_lidar(frame, length);
}

static void take_acknowledge(flight *self, const lidar_acknowledge *answer) {
    report_word("acknowledge");
    report_number((int64_t)answer->command);
    report_number((int64_t)answer->sequence);
    report_number((int64_t)answer->verdict);
    report_end();
    if (self->packets_since_command == 0u || answer->sequence != self->sequence)
        return;
    if (answer->verdict == LIDAR_VERDICT_ACCEPTED && self->pending_command == LIDAR_COMMAND_SET_PATTERN)
        self->is_narrow = true;
    self->is_standing_by = self->is_narrow_wanted = false; /* what is still needed shows in the next packet */
    self->sequence++;
    self->packets_since_command = 0u;
}

/* --------------------------------------------------------------------------------------------- measurements */

static void count_lost(flight *self, uint32_t shot) {
    const uint32_t gap = shot - self->next_shot;
    if (self->has_shot && gap < 0x80000000u)
        self->shots_lost += gap;
    self->has_shot = true;
    self->next_shot = shot + 1u;
}

static void report_shot(const flight *self, const navigation_solution *solution) {
    const lidar_measurement *measurement = &self->measurement;
    report_word("shot");
    report_number((int64_t)measurement->shot.shot);
    report_number(measurement->shot.time_ns);
    report_steps(measurement->beams[0].has_beam_angle_deg, measurement->beams[0].beam_angle_deg, 100);
    for (int k = 0; k < BEAMS; k++)
        report_steps(measurement->beams[k].range_valid, measurement->beams[k].range_m, 1000);
    for (int k = 0; k < BEAMS; k++)
        report_steps(measurement->beams[k].speed_valid, measurement->beams[k].closing_speed_mps, 10000);
    report_steps(solution->has_altitude, solution->altitude_m, 1000);
    for (int k = 0; k < 3; k++)
        report_steps(solution->has_velocity, solution->velocity_mps[k], 1000);
    report_number(self->shots_lost);
    report_number(self->receiver.bad_frames);
    report_end();
}

static void take_measurement(flight *self) {
    const navigation_solution solution = navigation_solve(&self->measurement);
    count_lost(self, (uint32_t)self->measurement.shot.shot);
    report_shot(self, &solution);
    if (self->packets_since_command == 0u) {
        self->is_standing_by = false;
        self->is_narrow_wanted = solution.has_altitude && solution.altitude_m < narrow_below_m;
    }
}

/* A device that stands by after a restart has the wide pattern again, and numbers its shots from 0. */
static void take_housekeeping(flight *self, const lidar_housekeeping *health) {
    if (health->mode == LIDAR_MODE_STANDBY && self->packets_since_command == 0u) {
        self->is_standing_by = true;
        self->is_narrow = self->has_shot = false;
    }
}

void flight_receive(flight *self, uint8_t byte) {
    lidar_receiver *receiver = &self->receiver;
    lidar_feed(receiver, byte);
    while (lidar_next(receiver)) {
        lidar_acknowledge answer;
        lidar_housekeeping health;
        unsigned unit;
        if (lidar_read_measurement(receiver->packet, receiver->packet_length, &unit, &self->measurement) &&
            self->measurement.beam_count == (size_t)BEAMS)
            take_measurement(self);
        else if (lidar_read_acknowledge(receiver->packet, receiver->packet_length, &unit, &answer))
            take_acknowledge(self, &answer);
        else if (lidar_read_housekeeping(receiver->packet, receiver->packet_length, &unit, &health))
            take_housekeeping(self, &health);
        command(self);
    }
}
