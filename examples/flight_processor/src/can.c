/* The lidar on CAN, unit 0, with the full set of messages. */
#include "can_controller.h"
#include "board.h"
#include "flight.h"
#include "link.h"

enum { BEAMS = 4, SHOT = 0x1, BEAM = 0x10, GEOMETRY = 0x100, WHOLE_SET = 0xFF1 };

/* A shot as its messages come; those of beam k are BEAM << k and GEOMETRY << k. */
static struct {
    lidar_measurement measurement;
    uint64_t counter;
    unsigned awaited;
} set;
static uint32_t bad_frames;

void link_send_set_mode(uint8_t sequence, uint64_t mode) {
    can_frame frame = {LIDAR_CAN_ID_SET_MODE, LIDAR_CAN_COMMAND_SET_MODE_BYTES, {0}};
    if (lidar_pack_can_set_mode(frame.data, sequence, mode))
        can_write(&frame);
}

void link_send_set_pattern(uint8_t sequence, uint64_t pattern) {
    can_frame frame = {LIDAR_CAN_ID_SET_PATTERN, LIDAR_CAN_COMMAND_SET_PATTERN_BYTES, {0}};
    if (lidar_pack_can_set_pattern(frame.data, sequence, pattern))
        can_write(&frame);
}

uint32_t link_bad_frames(void) { return bad_frames + can_overruns(); }

/* ------------------------------------------------------------------------------------------------------ solutions */

/* Frames of a solution, in the order in which they have to be sent. */
static const struct {
    unsigned id;
    size_t length;
    bool (*pack)(uint8_t *data, const lidar_message_navigation *message);
} parts[] = {
    {LIDAR_CAN_ID_NAVIGATION_TIME, LIDAR_CAN_NAVIGATION_TIME_BYTES, lidar_pack_can_navigation_time},
    {LIDAR_CAN_ID_NAVIGATION_ALTITUDE, LIDAR_CAN_NAVIGATION_ALTITUDE_BYTES, lidar_pack_can_navigation_altitude},
    {LIDAR_CAN_ID_NAVIGATION_VELOCITY_EAST, LIDAR_CAN_NAVIGATION_VELOCITY_EAST_BYTES, lidar_pack_can_navigation_velocity_east},
    {LIDAR_CAN_ID_NAVIGATION_VELOCITY_NORTH, LIDAR_CAN_NAVIGATION_VELOCITY_NORTH_BYTES, lidar_pack_can_navigation_velocity_north},
    {LIDAR_CAN_ID_NAVIGATION_VELOCITY_UP, LIDAR_CAN_NAVIGATION_VELOCITY_UP_BYTES, lidar_pack_can_navigation_velocity_up},
    {LIDAR_CAN_ID_NAVIGATION_POSITION_EAST, LIDAR_CAN_NAVIGATION_POSITION_EAST_BYTES, lidar_pack_can_navigation_position_east},
    {LIDAR_CAN_ID_NAVIGATION_POSITION_NORTH, LIDAR_CAN_NAVIGATION_POSITION_NORTH_BYTES, lidar_pack_can_navigation_position_north},
    {LIDAR_CAN_ID_NAVIGATION_POSITION_UP, LIDAR_CAN_NAVIGATION_POSITION_UP_BYTES, lidar_pack_can_navigation_position_up},
    {LIDAR_CAN_ID_NAVIGATION_USE, LIDAR_CAN_NAVIGATION_USE_BYTES, lidar_pack_can_navigation_use},
};
enum { PARTS = sizeof parts / sizeof parts[0] };
static struct {
    lidar_message_navigation message;
    size_t unsent_parts;
} outgoing;

void link_send_navigation(const lidar_message_navigation *message) {
    if (outgoing.unsent_parts > 0u)
        return;
    outgoing.message = *message;
    outgoing.unsent_parts = PARTS;
}

/* The controller has room for one frame: each waits for the one before. */
static void send_part(void) {
    if (outgoing.unsent_parts == 0u)
        return;
    const size_t place = PARTS - outgoing.unsent_parts;
    can_frame frame = {parts[place].id, parts[place].length, {0}};
    if (!parts[place].pack(frame.data, &outgoing.message))
        outgoing.unsent_parts = 0u; /* a value that the message cannot hold */
    else if (can_write(&frame))
        outgoing.unsent_parts--;
}

/* ------------------------------------------------------------------------------------------- messages of a shot */

/* Whether the set awaits a message. One that it does not await ends it. */
static bool is_awaited(uint64_t counter, unsigned message) {
    const bool awaited = counter == set.counter && (set.awaited & message) != 0u;
    set.awaited = awaited ? set.awaited & ~message : 0u;
    bad_frames += awaited ? 0u : 1u;
    return awaited;
}

static void begin_set(const uint8_t *data) {
    lidar_can_header header;
    bad_frames += set.awaited != 0u ? 1u : 0u;
    lidar_unpack_can_header(data, &header);
    set.counter = header.shot_counter;
    set.awaited = header.beam_count == BEAMS ? WHOLE_SET : 0u;
    set.measurement.beam_count = BEAMS;
    set.measurement.shot.time_ns = header.time_ns;
}

static bool take_shot(const uint8_t *data) {
    lidar_can_shot shot;
    lidar_unpack_can_shot(data, &shot);
    if (shot.interface_version != LIDAR_INTERFACE_VERSION || !is_awaited(shot.shot_counter, SHOT))
        return false;
    set.measurement.shot.shot = shot.shot;
    return true;
}

static bool take_beam(unsigned slot, const uint8_t *data) {
    lidar_can_beam beam;
    lidar_unpack_can_beam(data, &beam);
    if (!is_awaited(beam.shot_counter, (unsigned)BEAM << slot))
        return false;
    lidar_beam *to = &set.measurement.beams[slot];
    to->range_valid = beam.range_valid;
    to->has_range_m = beam.has_range_m;
    to->range_m = beam.range_m;
    to->speed_valid = beam.speed_valid;
    to->has_closing_speed_mps = beam.has_closing_speed_mps;
    to->closing_speed_mps = beam.closing_speed_mps;
    return true;
}

static bool take_geometry(unsigned slot, const uint8_t *data) {
    lidar_can_geometry geometry;
    lidar_unpack_can_geometry(data, &geometry);
    if (!is_awaited(geometry.shot_counter, (unsigned)GEOMETRY << slot))
        return false;
    lidar_beam *to = &set.measurement.beams[slot];
    to->has_beam_angle_deg = geometry.has_beam_angle_deg;
    to->beam_angle_deg = geometry.beam_angle_deg;
    return true;
}

/* --------------------------------------------------------------------------------------------------- all messages */

static void take_acknowledge(flight *self, const uint8_t *data) {
    lidar_can_acknowledge answer;
    lidar_unpack_can_acknowledge(data, &answer);
    flight_take_acknowledge(self, answer.command, answer.sequence, answer.verdict);
}

static void take_health(flight *self, const uint8_t *data) {
    lidar_can_health health;
    lidar_unpack_can_health(data, &health);
    flight_take_mode(self, health.mode);
}

static bool is_one_of(const can_frame *frame, unsigned first_id, unsigned count, size_t length) {
    return frame->id >= first_id && frame->id < first_id + count && frame->length == length;
}

static void receive(flight *self, const can_frame *frame) {
    bool is_taken = false;
    if (is_one_of(frame, LIDAR_CAN_ID_HEADER, 1u, LIDAR_CAN_HEADER_BYTES))
        begin_set(frame->data);
    else if (is_one_of(frame, LIDAR_CAN_ID_SHOT, 1u, LIDAR_CAN_SHOT_BYTES))
        is_taken = take_shot(frame->data);
    else if (is_one_of(frame, LIDAR_CAN_ID_BEAM, BEAMS, LIDAR_CAN_BEAM_BYTES))
        is_taken = take_beam(frame->id - LIDAR_CAN_ID_BEAM, frame->data);
    else if (is_one_of(frame, LIDAR_CAN_ID_GEOMETRY, BEAMS, LIDAR_CAN_GEOMETRY_BYTES))
        is_taken = take_geometry(frame->id - LIDAR_CAN_ID_GEOMETRY, frame->data);
    else if (is_one_of(frame, LIDAR_CAN_ID_ACKNOWLEDGE, 1u, LIDAR_CAN_ACKNOWLEDGE_BYTES))
        take_acknowledge(self, frame->data);
    else if (is_one_of(frame, LIDAR_CAN_ID_HEALTH, 1u, LIDAR_CAN_HEALTH_BYTES))
        take_health(self, frame->data);
    if (is_taken && set.awaited == 0u)
        flight_take_measurement(self, &set.measurement);
}

int main(void) {
    static flight self;
    board_start();
    can_start();
    for (;;) {
        can_frame frame;
        if (can_read(&frame))
            receive(&self, &frame);
        send_part();
    }
}
