/* The lidar on a serial line. */
#include "board.h"
#include "flight.h"
#include "link.h"

enum { UNIT = 0 };
static lidar_receiver receiver;

void link_send_set_mode(uint8_t sequence, uint64_t mode) {
    uint8_t frame[LIDAR_LONGEST_COMMAND];
    board_write_lidar(frame, lidar_encode_set_mode(frame, UNIT, sequence, mode));
}

void link_send_set_pattern(uint8_t sequence, uint64_t pattern) {
    uint8_t frame[LIDAR_LONGEST_COMMAND];
    board_write_lidar(frame, lidar_encode_set_pattern(frame, UNIT, sequence, pattern));
}

void link_send_navigation(const lidar_message_navigation *message) {
    uint8_t frame[LIDAR_LONGEST_MESSAGE];
    board_write_lidar(frame, lidar_encode_navigation(frame, UNIT, message));
}

uint32_t link_bad_frames(void) { return (uint32_t)receiver.bad_frames; }

static void receive(flight *self, uint8_t byte) {
    static lidar_measurement measurement; /* not on a small stack */
    lidar_acknowledge answer;
    lidar_housekeeping health;
    unsigned unit;
    lidar_feed(&receiver, byte);
    while (lidar_next(&receiver)) {
        if (lidar_read_measurement(receiver.packet, receiver.packet_length, &unit, &measurement))
            flight_take_measurement(self, &measurement);
        else if (lidar_read_acknowledge(receiver.packet, receiver.packet_length, &unit, &answer))
            flight_take_acknowledge(self, answer.command, answer.sequence, answer.verdict);
        else if (lidar_read_housekeeping(receiver.packet, receiver.packet_length, &unit, &health))
            flight_take_mode(self, health.mode);
    }
}

int main(void) {
    static flight self;
    board_start();
    for (;;) {
        const int byte = board_read_lidar();
        if (byte >= 0)
            receive(&self, (uint8_t)byte);
    }
}
