#include "flight.h"
#include "link.h"
#include "navigation.h"
#include "report.h"

enum { BEAMS = 4, NARROW_PATTERN = 1, MESSAGES_UNTIL_REPEATED = 5 };
static const lidar_real narrow_below_m = (lidar_real)500;

/* ------------------------------------------------------------------------------------------------- commands */

/* Send the command that is needed next. While one is pending it is repeated with its own number: it or its answer may be lost. */
static void command(flight *self) {
    if (self->messages_since_command != 0u && self->messages_since_command++ < MESSAGES_UNTIL_REPEATED)
        return;
    if (self->is_standing_by) {
        self->pending_command = LIDAR_COMMAND_SET_MODE;
        link_send_set_mode(self->sequence, LIDAR_MODE_TRACK);
    } else if (self->is_narrow_wanted && !self->is_narrow) {
        self->pending_command = LIDAR_COMMAND_SET_PATTERN;
        link_send_set_pattern(self->sequence, NARROW_PATTERN);
    } else {
        return;
    }
    self->messages_since_command = 1u;
}

static void end_command(flight *self, uint64_t verdict) {
    if (verdict == LIDAR_VERDICT_ACCEPTED && self->pending_command == LIDAR_COMMAND_SET_PATTERN)
        self->is_narrow = true;
    self->is_standing_by = self->is_narrow_wanted = false; /* what is still needed shows in the next message */
    self->sequence++;
    self->messages_since_command = 0u;
}

void flight_take_acknowledge(flight *self, uint64_t of_command, uint64_t sequence, uint64_t verdict) {
    report_word("acknowledge");
    report_number((int64_t)of_command);
    report_number((int64_t)sequence);
    report_number((int64_t)verdict);
    report_end();
    if (self->messages_since_command != 0u && sequence == self->sequence)
        end_command(self, verdict);
    command(self);
}

/* --------------------------------------------------------------------------------------------- measurements */

static void count_lost(flight *self, uint32_t shot) {
    const uint32_t gap = shot - self->next_shot;
    if (self->has_shot && gap < 0x80000000u)
        self->shots_lost += gap;
    self->has_shot = true;
    self->next_shot = shot + 1u;
}

static void report_shot(const flight *self, const lidar_measurement *measurement, const navigation_solution *solution) {
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
    report_number(link_bad_frames());
    report_end();
}

static uint64_t trust(bool is_valid, bool is_solved) {
    return is_valid ? (is_solved ? LIDAR_TRUST_USED : LIDAR_TRUST_EXCLUDED) : LIDAR_TRUST_INVALID;
}

/* Velocity to the east and north would need the attitude, which no beam measures: they have no value, and no deviation has. */
static void send_solution(flight *self, const lidar_measurement *measurement, const navigation_solution *solution) {
    static lidar_message_navigation message; /* not on a small stack */
    const lidar_beam *beams = measurement->beams;
    message.sequence = self->solutions++;
    message.time_ns = measurement->shot.time_ns;
    message.mode = solution->has_altitude && solution->has_velocity ? LIDAR_NAVIGATION_MODE_AIDED : LIDAR_NAVIGATION_MODE_FAILED;
    message.has_altitude_m = solution->has_altitude;
    message.altitude_m = solution->altitude_m;
    message.has_velocity_up_mps = solution->has_velocity;
    message.velocity_up_mps = -solution->velocity_mps[2];
    message.range_trust_0 = trust(beams[0].range_valid, solution->has_altitude);
    message.range_trust_1 = trust(beams[1].range_valid, solution->has_altitude);
    message.range_trust_2 = trust(beams[2].range_valid, solution->has_altitude);
    message.range_trust_3 = trust(beams[3].range_valid, solution->has_altitude);
    message.speed_trust_0 = trust(beams[0].speed_valid, solution->has_velocity);
    message.speed_trust_1 = trust(beams[1].speed_valid, solution->has_velocity);
    message.speed_trust_2 = trust(beams[2].speed_valid, solution->has_velocity);
    message.speed_trust_3 = trust(beams[3].speed_valid, solution->has_velocity);
    link_send_navigation(&message);
}

void flight_take_measurement(flight *self, const lidar_measurement *measurement) {
    if (measurement->beam_count != (size_t)BEAMS)
        return;
    const navigation_solution solution = navigation_solve(measurement);
    count_lost(self, (uint32_t)measurement->shot.shot);
    report_shot(self, measurement, &solution);
    if (self->messages_since_command == 0u) {
        self->is_standing_by = false;
        self->is_narrow_wanted = solution.has_altitude && solution.altitude_m < narrow_below_m;
    }
    command(self);
    send_solution(self, measurement, &solution);
}

/* A device that stands by after a restart has the wide pattern again, and numbers its shots from 0. */
void flight_take_mode(flight *self, uint64_t mode) {
    if (mode == LIDAR_MODE_STANDBY && self->messages_since_command == 0u) {
        self->is_standing_by = true;
        self->is_narrow = self->has_shot = false;
    }
    command(self);
}
