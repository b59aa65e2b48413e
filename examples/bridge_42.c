/* 42 to an emulated lidar, in lockstep: 42 connects to it, sends its state each step, and continues once the lidar has
 * replied.
 *
 *     cc -std=c99 bridge_42.c -o bridge_42 -lm
 *     ./bridge_42 10001 5600 LATITUDE_DEG LONGITUDE_DEG RADIUS_M MERIDIAN_DEG ROTATION_RADPS
 *
 * The ports of 42 and of the lidar, then the site: see site_frame.h. docs/simulators.md has the entry of Inp_IPC.txt. */
#define _POSIX_C_SOURCE 200809L
#include "lidar_truth_link.h"
#include "site_frame.h"

enum { TIME = 1, ORBIT_POSITION = 2, ORBIT_VELOCITY = 4, POSITION = 8, VELOCITY = 16, ATTITUDE = 32, RATE = 64, ALL = 127 };

/* State of the vehicle, and which parts of it a message had. */
struct state {
    unsigned parts;
    int64_t utc_ns;
    double orbit_position_m[3], orbit_velocity_mps[3], position_m[3], velocity_mps[3];
    double attitude[4]; /* of body 0; same components as inertial_from_body, but scalar last */
    double rate_radps[3];
};

static const double rad_per_deg = 0.01745329251994329577;

static int64_t days_before(long year) {
    const long last = year - 1;
    return 365 * (int64_t)last + last / 4 - last / 100 + last / 400;
}

static void read_time(const char *line, struct state *to) {
    long year, day, hour, minute;
    double second;
    if (sscanf(line, "TIME %ld-%ld-%ld:%ld:%lf", &year, &day, &hour, &minute, &second) != 5)
        return;
    to->utc_ns = (((days_before(year) + day) * 24 + hour) * 60 + minute) * 60 * INT64_C(1000000000);
    to->utc_ns += llround(second * 1e9);
    to->parts |= TIME;
}

/* Read "NAME = [1 2 3]"; older versions of 42 write no brackets. */
static void read_values(const char *line, const char *name, unsigned part, int count, double *values, struct state *to) {
    const size_t length = strlen(name);
    if (strncmp(line, name, length) != 0 || strncmp(line + length, " = ", 3) != 0)
        return;
    const char *next = line + length + 3;
    next += *next == '[';
    for (int k = 0; k < count; k++) {
        char *end;
        values[k] = strtod(next, &end);
        if (end == next)
            return;
        next = end;
    }
    to->parts |= part;
}

/* Read a message, from TIME to its last line; false at the end of the connection. */
static int read_message(FILE *simulator, struct state *to) {
    char line[512];
    to->parts = 0;
    while (fgets(line, sizeof line, simulator) != NULL) {
        if (strncmp(line, "[ENDMSG]", 8) == 0 || strncmp(line, "[EOF]", 5) == 0)
            return 1;
        read_time(line, to);
        read_values(line, "Orb[0].PosN", ORBIT_POSITION, 3, to->orbit_position_m, to);
        read_values(line, "Orb[0].VelN", ORBIT_VELOCITY, 3, to->orbit_velocity_mps, to);
        read_values(line, "SC[0].PosR", POSITION, 3, to->position_m, to);
        read_values(line, "SC[0].VelR", VELOCITY, 3, to->velocity_mps, to);
        read_values(line, "SC[0].B[0].qn", ATTITUDE, 4, to->attitude, to);
        read_values(line, "SC[0].B[0].wn", RATE, 3, to->rate_radps, to);
    }
    return 0;
}

static void fill_truth(const struct site_frame *site, double time_s, const struct state *from, struct lidar_truth *truth) {
    const double inertial_from_body[4] = {from->attitude[3], from->attitude[0], from->attitude[1], from->attitude[2]};
    double position_m[3], velocity_mps[3];
    for (int k = 0; k < 3; k++) {
        position_m[k] = from->orbit_position_m[k] + from->position_m[k];
        velocity_mps[k] = from->orbit_velocity_mps[k] + from->velocity_mps[k];
    }
    site_fill_truth(site, time_s, position_m, velocity_mps, inertial_from_body, from->rate_radps, truth);
}

/* Relay truths until 42 ends; return the number of packets in the replies, negative after an error. */
static long relay(FILE *simulator, int acknowledge, int lidar, const struct site_frame *site) {
    struct state state;
    struct lidar_truth truth;
    int64_t start_ns = 0;
    uint32_t sequence = 0;
    long packets = 0, more = 0;
    for (; read_message(simulator, &state); sequence++) {
        if (state.parts != ALL) {
            fprintf(stderr, "42 does not send time, SC[0] and Orb[0]: see the prefixes in Inp_IPC.txt\n");
            return -1;
        }
        if (sequence == 0)
            start_ns = state.utc_ns;
        lidar_truth_begin(&truth, sequence, state.utc_ns - start_ns);
        fill_truth(site, (double)truth.time_ns * 1e-9, &state, &truth);
        more = lidar_truth_send_and_wait(lidar, &truth);
        if (more < 0 || write(acknowledge, "Ack", 4) != 4)
            return -1;
        packets += more;
    }
    if (sequence == 0)
        return -1;
    truth.sequence = sequence;
    truth.flags |= LIDAR_TRUTH_LAST; /* counts on a repeat of the same time */
    more = lidar_truth_send_and_wait(lidar, &truth);
    return more < 0 ? -1 : packets;
}

/* Wait for the connection of 42. */
static int accept_simulator(uint16_t port) {
    struct sockaddr_in address = {0};
    const int listening = socket(AF_INET, SOCK_STREAM, 0), reuse = 1;
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    setsockopt(listening, SOL_SOCKET, SO_REUSEADDR, &reuse, sizeof reuse);
    if (listening < 0 || bind(listening, (struct sockaddr *)&address, sizeof address) != 0 || listen(listening, 1) != 0)
        return -1;
    return accept(listening, NULL, NULL);
}

int main(int count, char **arguments) {
    if (count != 8) {
        fprintf(stderr, "usage: bridge_42 PORT_OF_42 PORT_OF_LIDAR LATITUDE_DEG LONGITUDE_DEG RADIUS_M MERIDIAN_DEG "
                        "ROTATION_RADPS\n");
        return 2;
    }
    const struct site_frame site = {atof(arguments[3]) * rad_per_deg, atof(arguments[4]) * rad_per_deg,
                                    atof(arguments[5]), atof(arguments[6]) * rad_per_deg, atof(arguments[7])};
    const int lidar = lidar_truth_open((uint16_t)atoi(arguments[2]));
    const int simulator = lidar < 0 ? -1 : accept_simulator((uint16_t)atoi(arguments[1]));
    FILE *const text = simulator < 0 ? NULL : fdopen(simulator, "r");
    if (text == NULL) {
        perror("bridge_42");
        return 1;
    }
    const long packets = relay(text, simulator, lidar, &site);
    if (packets >= 0)
        printf("%ld packets in the replies\n", packets);
    return packets < 0;
}
