/* altimeter PORT: a line for every height, which it also sends back as `navigation`; "stale" after half a second without
 * one, counts at the end of the port. */
#define _DEFAULT_SOURCE

#include "altimeter.h"

#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <termios.h>
#include <unistd.h>

enum { STALE_AFTER_MS = 500 };

static int open_raw(const char *path) {
    struct termios settings;
    const int port = open(path, O_RDWR | O_NOCTTY);
    if (port < 0 || tcgetattr(port, &settings) != 0)
        return -1;
    cfmakeraw(&settings);
    cfsetspeed(&settings, B921600);
    return tcsetattr(port, TCSANOW, &settings) == 0 ? port : -1;
}

static void print_height(const altimeter_height *height) {
    printf("height shot=%" PRIu64 " time_ns=%" PRId64 " beams=%u height_m=%.3f\n", height->shot, height->time_ns,
           height->beams, height->height_m);
}

/* A height that the line does not take is lost, as a packet would be. */
static void send_height(int port, const altimeter_height *height) {
    static uint64_t sequence;
    uint8_t frame[LIDAR_LONGEST_MESSAGE];
    const lidar_message_navigation message = {.sequence = sequence, .time_ns = height->time_ns, .mode = 3,
                                              .has_altitude_m = true, .altitude_m = height->height_m};
    const size_t length = lidar_encode_navigation(frame, 0u, &message);
    if (write(port, frame, length) == (ssize_t)length)
        sequence = (sequence + 1u) % 256u;
}

int main(int argc, char **argv) {
    static altimeter lidar; /* too large for a small stack */
    altimeter_height height;
    uint8_t bytes[256];
    bool is_stale = false;
    const int port = argc == 2 ? open_raw(argv[1]) : -1;
    if (port < 0) {
        fprintf(stderr, "usage: altimeter PORT, a serial port that can be opened\n");
        return 2;
    }
    setvbuf(stdout, NULL, _IOLBF, 0);
    for (;;) {
        struct pollfd waiting = {.fd = port, .events = POLLIN};
        if (poll(&waiting, 1, STALE_AFTER_MS) == 0) {
            if (!is_stale)
                printf("stale\n");
            is_stale = true;
            continue;
        }
        const ssize_t count = read(port, bytes, sizeof bytes);
        if (count <= 0)
            break;
        for (ssize_t k = 0; k < count; k++)
            if (altimeter_feed(&lidar, bytes[k], &height)) {
                print_height(&height);
                send_height(port, &height);
                is_stale = false;
            }
    }
    printf("end bad_frames=%u\n", (unsigned)lidar.receiver.bad_frames);
    return 0;
}
