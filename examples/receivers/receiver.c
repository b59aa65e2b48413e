/* Receiver for a lidar on a serial line: a line of JSON for every message, and commands at chosen shots.
 *
 *     cc -std=c99 -I ../../protocol/lidar_protocol receiver.c -o receiver
 *     ./receiver /dev/ttyUSB0 921600
 *     ./receiver /dev/ttyUSB0 921600 2000:set_pattern=1 3000:set_pattern=0
 *
 * The port may be "-", the standard input, to read a capture. receiver.py prints the same lines. The program shares
 * only lidar.h with the device. Access to the port is POSIX, the rest is C99.
 */
#define _DEFAULT_SOURCE

#include "lidar.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { UNIT = 0, MAX_COMMANDS = 32, TIMEOUT_MS = 1000 };

/* ---------------------------------------------------------------------------------------- messages as lines */

static void print_flag(const char *name, bool value) {
    printf(",\"%s\":%s", name, value ? "true" : "false");
}

static void print_whole(const char *name, uint64_t value) {
    printf(",\"%s\":%" PRIu64, name, value);
}

static void print_time(const char *name, int64_t time_ns) {
    printf(",\"%s\":%" PRId64, name, time_ns);
}

static void print_number(const char *name, bool has_value, double value, int decimals) {
    if (has_value)
        printf(",\"%s\":%.*f", name, decimals, value);
    else
        printf(",\"%s\":null", name);
}

static void print_beam(size_t number, const lidar_beam *beam) {
    printf("%s{\"beam\":%zu", number == 0u ? "" : ",", number);
    print_flag("fired", beam->fired);
    print_flag("range_valid", beam->range_valid);
    print_flag("speed_valid", beam->speed_valid);
    print_flag("sign_resolved", beam->sign_resolved);
    print_whole("segments", beam->segments);
    print_whole("reason", beam->reason);
    print_whole("returns", beam->returns);
    print_number("snr_db", beam->has_snr_db, beam->snr_db, 2);
    print_number("range_m", beam->has_range_m, beam->range_m, 3);
    print_number("closing_speed_mps", beam->has_closing_speed_mps, beam->closing_speed_mps, 4);
    print_number("second_range_m", beam->has_second_range_m, beam->second_range_m, 3);
    print_number("sigma_range_m", beam->has_sigma_range_m, beam->sigma_range_m, 4);
    print_number("sigma_speed_mps", beam->has_sigma_speed_mps, beam->sigma_speed_mps, 5);
    print_number("residual_mps", beam->has_residual_mps, beam->residual_mps, 4);
    print_number("beam_angle_deg", beam->has_beam_angle_deg, beam->beam_angle_deg, 2);
    print_number("time_offset_s", beam->has_time_offset_s, beam->time_offset_s, 6);
    print_number("second_sigma_range_m", beam->has_second_sigma_range_m, beam->second_sigma_range_m, 4);
    print_whole("second_reason", beam->second_reason);
    printf("}");
}

static void print_measurement(unsigned unit, const lidar_measurement *measurement) {
    const lidar_shot *shot = &measurement->shot;
    printf("{\"kind\":\"measurement\",\"unit\":%u", unit);
    print_whole("shot", shot->shot);
    print_whole("pattern", shot->pattern);
    print_time("time_ns", shot->time_ns);
    print_time("due_ns", shot->due_ns);
    print_whole("mode", shot->mode);
    print_flag("laser_on", shot->laser_on);
    print_flag("clock_locked", shot->clock_locked);
    printf(",\"beams\":[");
    for (size_t k = 0u; k < measurement->beam_count; k++)
        print_beam(k, &measurement->beams[k]);
    printf("]}\n");
}

static void print_acknowledge(unsigned unit, const lidar_acknowledge *answer) {
    printf("{\"kind\":\"acknowledge\",\"unit\":%u", unit);
    print_time("time_ns", answer->time_ns);
    print_whole("command", answer->command);
    print_whole("sequence", answer->sequence);
    print_whole("verdict", answer->verdict);
    printf("}\n");
}

static void print_housekeeping(unsigned unit, const lidar_housekeeping *health) {
    printf("{\"kind\":\"housekeeping\",\"unit\":%u", unit);
    print_time("time_ns", health->time_ns);
    print_whole("mode", health->mode);
    print_flag("interlock_closed", health->interlock_closed);
    print_flag("laser_on", health->laser_on);
    print_flag("clock_locked", health->clock_locked);
    print_number("temperature_c", health->has_temperature_c, health->temperature_c, 2);
    print_number("laser_power_w", health->has_laser_power_w, health->laser_power_w, 3);
    print_number("uptime_s", health->has_uptime_s, (double)health->uptime_s, 0);
    print_whole("shots_dropped", health->shots_dropped);
    print_whole("shots_late", health->shots_late);
    print_whole("commands_accepted", health->commands_accepted);
    print_whole("commands_rejected", health->commands_rejected);
    print_whole("bad_bytes", health->bad_bytes);
    printf("}\n");
}

/* -------------------------------------------------------------------------------------------------- commands */

/* "2000:set_pattern=1": a command, sent after this shot was received; commands of shot 0 are sent at once. */
typedef struct {
    uint64_t shot;
    char name[32];
    double value;
} host_command;

/* Sends one command at a time. It is repeated until it is acknowledged, since command or acknowledgement may be lost,
 * and with the next sequence number while the device rejects it in its present mode. */
typedef struct {
    host_command commands[MAX_COMMANDS];
    size_t count, done;
    uint8_t sequence;
    bool is_waiting;
    int64_t sent_ms;
} commander;

static int64_t now_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static bool parse_command(const char *text, host_command *to) {
    int used = 0;
    to->value = 0.0;
    if (text[0] == '-' || sscanf(text, "%" SCNu64 ":%31[a-z_]%n", &to->shot, to->name, &used) != 2)
        return false;
    text += used;
    return *text == '\0' || (sscanf(text, "=%lf%n", &to->value, &used) == 1 && text[used] == '\0');
}

/* Encode a command; returns the number of bytes, 0 if the command is unknown or its value is out of range. */
static size_t encode(uint8_t *frame, uint8_t sequence, const host_command *to_send) {
    const uint64_t whole = to_send->value >= 0.0 && to_send->value < 4294967296.0 ? (uint64_t)to_send->value : UINT64_MAX;
    if (strcmp(to_send->name, "no_op") == 0)
        return lidar_encode_no_op(frame, UNIT, sequence);
    if (strcmp(to_send->name, "set_mode") == 0)
        return lidar_encode_set_mode(frame, UNIT, sequence, whole);
    if (strcmp(to_send->name, "set_pattern") == 0)
        return lidar_encode_set_pattern(frame, UNIT, sequence, whole);
    if (strcmp(to_send->name, "set_rate_hz") == 0)
        return lidar_encode_set_rate_hz(frame, UNIT, sequence, to_send->value);
    if (strcmp(to_send->name, "enable_beams") == 0)
        return lidar_encode_enable_beams(frame, UNIT, sequence, whole);
    if (strcmp(to_send->name, "reset") == 0)
        return lidar_encode_reset(frame, UNIT, sequence, whole);
    return 0u;
}

static void send_bytes(int port, const uint8_t *data, size_t length) {
    while (length > 0u) {
        const ssize_t written = write(port, data, length);
        if (written < 0 && errno != EINTR)
            return; /* the link is broken: reading will report it */
        if (written > 0) {
            data += written;
            length -= (size_t)written;
        }
    }
}

/* Send what is due, or repeat it. */
static void command(commander *host, int port, uint64_t newest_shot) {
    const host_command *next = &host->commands[host->done];
    uint8_t frame[LIDAR_LONGEST_COMMAND];
    if (host->done == host->count || newest_shot < next->shot)
        return;
    if (host->is_waiting && now_ms() - host->sent_ms < TIMEOUT_MS)
        return;
    send_bytes(port, frame, encode(frame, host->sequence, next));
    host->sent_ms = now_ms();
    host->is_waiting = true;
}

static void answered(commander *host, const lidar_acknowledge *answer) {
    if (!host->is_waiting || answer->sequence != host->sequence)
        return;
    host->sequence++; /* 0 after 255 */
    if (answer->verdict == LIDAR_VERDICT_OUT_OF_STATE)
        return; /* repeated after the timeout */
    host->is_waiting = false;
    host->done++;
}

/* -------------------------------------------------------------------------------------------------- messages */

typedef struct {
    uint64_t measurements, acknowledges, housekeeping, foreign;
    uint64_t gaps, lost_shots, repeats;
    uint32_t newest_shot;
} counts;

/* Count gaps: shots are numbered in 32 bits; an increment other than 1 means lost or repeated shots, or a restart. */
static void count_shot(counts *seen, uint32_t shot) {
    const uint32_t missing = shot - seen->newest_shot - 1u;
    if (seen->measurements > 0u && missing >= UINT32_MAX / 2u)
        seen->repeats++;
    else if (seen->measurements > 0u && missing > 0u) {
        seen->gaps++;
        seen->lost_shots += missing;
    }
    seen->newest_shot = shot;
    seen->measurements++;
}

static void take(const lidar_receiver *receiver, counts *seen, commander *host) {
    static lidar_measurement measurement; /* 64 beams: not on a small stack */
    lidar_acknowledge answer;
    lidar_housekeeping health;
    unsigned unit;
    if (lidar_read_measurement(receiver->packet, receiver->packet_length, &unit, &measurement)) {
        count_shot(seen, (uint32_t)measurement.shot.shot);
        print_measurement(unit, &measurement);
    } else if (lidar_read_acknowledge(receiver->packet, receiver->packet_length, &unit, &answer)) {
        seen->acknowledges++;
        answered(host, &answer);
        print_acknowledge(unit, &answer);
    } else if (lidar_read_housekeeping(receiver->packet, receiver->packet_length, &unit, &health)) {
        seen->housekeeping++;
        print_housekeeping(unit, &health);
    } else {
        seen->foreign++; /* another version of the interface */
    }
}

static void print_end(const counts *seen, const lidar_receiver *receiver) {
    printf("{\"kind\":\"end\"");
    print_whole("measurements", seen->measurements);
    print_whole("acknowledges", seen->acknowledges);
    print_whole("housekeeping", seen->housekeeping);
    print_whole("bad_frames", receiver->bad_frames + seen->foreign);
    print_whole("gaps", seen->gaps);
    print_whole("lost_shots", seen->lost_shots);
    print_whole("repeats", seen->repeats);
    printf("}\n");
}

/* -------------------------------------------------------------------------------------------------- the port */

static speed_t speed_of(long baud) {
    switch (baud) {
    case 9600: return B9600;
    case 19200: return B19200;
    case 38400: return B38400;
    case 57600: return B57600;
    case 115200: return B115200;
    case 230400: return B230400;
#ifdef B460800
    case 460800: return B460800;
#endif
#ifdef B921600
    case 921600: return B921600;
#endif
#ifdef B1000000
    case 1000000: return B1000000;
#endif
#ifdef B3000000
    case 3000000: return B3000000;
#endif
    default: return B0;
    }
}

/* Raw mode, in which a terminal passes every byte unchanged. */
static int open_port(const char *path, long baud) {
    struct termios settings;
    int port;
    if (strcmp(path, "-") == 0)
        return STDIN_FILENO;
    port = open(path, O_RDWR | O_NOCTTY);
    if (port < 0 || tcgetattr(port, &settings) < 0)
        return port;
    cfmakeraw(&settings);
    settings.c_cflag |= CLOCAL | CREAD;
    if (cfsetspeed(&settings, speed_of(baud)) < 0 || tcsetattr(port, TCSANOW, &settings) < 0)
        return -1;
    return port;
}

/* Read until the other side closes the line. */
static void follow(int port, commander *host) {
    static lidar_receiver receiver;
    static counts seen;
    uint8_t data[4096];
    struct pollfd watched = {.fd = port, .events = POLLIN};
    for (;;) {
        command(host, port, seen.newest_shot);
        if (poll(&watched, 1, host->is_waiting ? TIMEOUT_MS / 10 : -1) <= 0)
            continue;
        const ssize_t count = read(port, data, sizeof data);
        if (count < 0 && errno == EINTR)
            continue;
        if (count <= 0)
            break;
        for (ssize_t k = 0; k < count; k++) {
            lidar_feed(&receiver, data[k]);
            while (lidar_next(&receiver)) {
                take(&receiver, &seen, host);
                command(host, port, seen.newest_shot);
            }
        }
    }
    print_end(&seen, &receiver);
}

int main(int argc, char **argv) {
    static commander host;
    uint8_t frame[LIDAR_LONGEST_COMMAND];
    const long baud = argc > 2 ? strtol(argv[2], NULL, 10) : 0;
    if (argc < 3 || argc - 3 > MAX_COMMANDS || speed_of(baud) == B0) {
        fprintf(stderr, "usage: receiver PORT BAUD [SHOT:COMMAND[=VALUE]]...\n");
        return 2;
    }
    for (int k = 3; k < argc; k++) {
        host_command *next = &host.commands[host.count++];
        if (!parse_command(argv[k], next) || encode(frame, 0u, next) == 0u) {
            fprintf(stderr, "%s: not a command such as 2000:set_pattern=1\n", argv[k]);
            return 2;
        }
    }
    const int port = open_port(argv[1], baud);
    if (port < 0) {
        perror(argv[1]);
        return 1;
    }
    setvbuf(stdout, NULL, _IOLBF, 0u);
    follow(port, &host);
    return 0;
}
