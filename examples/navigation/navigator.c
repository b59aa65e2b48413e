/* A navigator to copy: velocity and height from the beams of a lidar on a serial line, sent back as `navigation`.
 *
 *     cc -std=c99 -I ../../protocol/lidar_protocol navigator.c -o navigator -lm
 *     ./navigator PORT [MOTION.csv]
 *
 * Recursive least squares: velocity, acceleration and height are predicted to each shot, and every valid beam that
 * agrees with the prediction, and with the other speeds, corrects them. Attitude comes from your inertial unit; in its
 * place is MOTION.csv, a table of `lidar-emu simulate`; without one, body x points north and z down.
 */
#define _DEFAULT_SOURCE
#define LIDAR_MAXIMUM_BEAMS 8

#include "lidar.h"

#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { UNIT = 0, BEAMS = 4, ACCELERATION = 3, HEIGHT = 6, STATES = 7, MOST_ROWS = 100000, LINE = 4096 };
enum { NOT_JUDGED = 0, USED = 1, INVALID = 2, GATED = 3, INCONSISTENT = 4, UNTIMELY = 5, INERTIAL = 2, AIDED = 3 };

static const double RAD_PER_DEG = 3.14159265358979323846 / 180.0;
static const double AZIMUTH_DEG[BEAMS] = {45, 135, 225, 315}; /* INTERFACE.md, section 8 */
static const double GATE_SIGMAS = 5, SPEED_SIGMA_MPS = 0.005, HEIGHT_SIGMA_M = 0.3, HEIGHT_SIGMA_SHARE = 0.01;
static const double PARITY_MPS = 0.05; /* five times the sigma of four speeds */
static const double JERK_NOISE = 1.0, SLOPE_NOISE = 0.1; /* m/s^2, and a share of the speed, in a second */
static const int64_t AHEAD_NS = 300000000;   /* a time stamp farther ahead is wrong */
static const int64_t SILENCE_NS = 450000000; /* a solution is expected twice a second */
static const int MOST_UNTIMELY = 100;        /* then the device's clock was set, and is believed */

/* East, north, up: velocity, acceleration; then the height above the ground; and their covariance. */
static double state[STATES], covariance[STATES][STATES];
static int64_t state_ns, ahead_of_ns; /* device's time of the state; by what it is ahead of this computer's clock */
static bool is_started;
static int untimely;
static unsigned range_trust[LIDAR_MAXIMUM_BEAMS], speed_trust[LIDAR_MAXIMUM_BEAMS];
static double motion[MOST_ROWS][5]; /* time_s, site_from_body */
static size_t motion_rows;

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec + ahead_of_ns;
}

/* ------------------------------------------------------------------------------------------ prediction, correction */

static void start(int64_t time_ns) {
    memset(state, 0, sizeof state);
    memset(covariance, 0, sizeof covariance);
    for (int i = 0; i < STATES; i++)
        covariance[i][i] = i < ACCELERATION ? 1e4 : i < HEIGHT ? 10.0 : 1e8;
    state_ns = time_ns;
    is_started = true;
}

/* One vector of states, `stride` apart, a time step later. */
static void advance(double *at, size_t stride, double step_s) {
    at[HEIGHT * stride] += step_s * (at[2 * stride] + 0.5 * step_s * at[5 * stride]);
    for (size_t i = 0; i < 3; i++)
        at[i * stride] += step_s * at[(ACCELERATION + i) * stride];
}

static void predict(int64_t to_ns) {
    const double step_s = (double)(to_ns - state_ns) * 1e-9, speed_mps = hypot(state[0], state[1]);
    advance(state, 1, step_s);
    for (size_t i = 0; i < STATES; i++)
        advance(&covariance[0][i], STATES, step_s);
    for (size_t i = 0; i < STATES; i++)
        advance(covariance[i], 1, step_s);
    for (size_t i = ACCELERATION; i < HEIGHT; i++)
        covariance[i][i] += JERK_NOISE * JERK_NOISE * step_s;
    covariance[HEIGHT][HEIGHT] += pow(SLOPE_NOISE * (speed_mps + 1), 2) * step_s;
    state_ns = to_ns;
}

/* Correct the state by a measured sum of states times `design`; false, and nothing, where it is beyond the gate. */
static bool correct(const double *design, double measured, double sigma) {
    double error = measured, cross[STATES], variance = sigma * sigma;
    for (int i = 0; i < STATES; i++) {
        error -= design[i] * state[i];
        cross[i] = 0;
        for (int j = 0; j < STATES; j++)
            cross[i] += covariance[i][j] * design[j];
        variance += design[i] * cross[i];
    }
    if (fabs(error) > GATE_SIGMAS * sqrt(variance))
        return false;
    for (int i = 0; i < STATES; i++) {
        state[i] += cross[i] * error / variance;
        for (int j = 0; j < STATES; j++)
            covariance[i][j] -= cross[i] * cross[j] / variance;
    }
    return true;
}

/* --------------------------------------------------------------------------------------------------------- attitude */

/* Quaternion at a time, scalar first: that of the row of the table that is nearest to it. */
static const double *site_from_body(int64_t time_ns) {
    static const double north_down[4] = {0, 0.70710678118654752, 0.70710678118654752, 0};
    static size_t row;
    const double time_s = (double)time_ns * 1e-9;
    while (row + 1 < motion_rows && fabs(motion[row + 1][0] - time_s) <= fabs(motion[row][0] - time_s))
        row++;
    return motion_rows > 0 ? &motion[row][1] : north_down;
}

/* site = body + 2 q x (q x body + w body) */
static void rotate(const double *quaternion, const double *body, double *site) {
    const double w = quaternion[0], *q = quaternion + 1;
    double t[3];
    for (int i = 0; i < 3; i++)
        t[i] = q[(i + 1) % 3] * body[(i + 2) % 3] - q[(i + 2) % 3] * body[(i + 1) % 3] + w * body[i];
    for (int i = 0; i < 3; i++)
        site[i] = body[i] + 2 * (q[(i + 1) % 3] * t[(i + 2) % 3] - q[(i + 2) % 3] * t[(i + 1) % 3]);
}

/* Read the columns of time and attitude; false unless the file has them and fits. */
static bool read_motion(const char *path) {
    static const char *const names[5] = {"time_s", "site_from_body_w", "site_from_body_x", "site_from_body_y",
                                         "site_from_body_z"};
    static char line[LINE];
    int column[5] = {-1, -1, -1, -1, -1}, found = 0, count = 0;
    FILE *file = fopen(path, "r");
    if (file == NULL || fgets(line, LINE, file) == NULL)
        return false;
    for (char *cell = strtok(line, ",\r\n"); cell != NULL; cell = strtok(NULL, ",\r\n"), count++)
        for (int i = 0; i < 5; i++)
            if (strcmp(cell, names[i]) == 0)
                column[i] = count, found++;
    for (; motion_rows < MOST_ROWS && fgets(line, LINE, file) != NULL; motion_rows++) {
        const char *cell = line;
        for (int at = 0; cell != NULL; at++) {
            for (int i = 0; i < 5; i++)
                if (column[i] == at)
                    motion[motion_rows][i] = strtod(cell, NULL);
            cell = strchr(cell, ',');
            cell += cell != NULL;
        }
    }
    const bool is_whole = feof(file) != 0;
    fclose(file);
    return is_whole && found == 5 && motion_rows > 0;
}

/* ----------------------------------------------------------------------------------------------------- shot, answer */

static void answer(int port, unsigned mode) {
    static uint64_t sequence;
    const double sigma_m = sqrt(covariance[HEIGHT][HEIGHT]) + HEIGHT_SIGMA_SHARE * fabs(state[HEIGHT]);
    const double sigma_mps[3] = {sqrt(covariance[0][0]), sqrt(covariance[1][1]), sqrt(covariance[2][2])};
    const bool has_velocity = sigma_mps[0] < 50 && sigma_mps[1] < 50 && sigma_mps[2] < 50;
    uint8_t frame[LIDAR_LONGEST_MESSAGE];
    lidar_message_navigation to_send = {.sequence = sequence, .time_ns = state_ns, .mode = mode};
    to_send.has_altitude_m = to_send.has_sigma_altitude_m = sigma_m < 200;
    to_send.altitude_m = state[HEIGHT], to_send.sigma_altitude_m = sigma_m;
    to_send.has_velocity_east_mps = to_send.has_velocity_north_mps = to_send.has_velocity_up_mps = has_velocity;
    to_send.velocity_east_mps = state[0], to_send.velocity_north_mps = state[1], to_send.velocity_up_mps = state[2];
    to_send.has_sigma_velocity_east_mps = to_send.has_sigma_velocity_north_mps = has_velocity;
    to_send.has_sigma_velocity_up_mps = has_velocity;
    to_send.sigma_velocity_east_mps = sigma_mps[0], to_send.sigma_velocity_north_mps = sigma_mps[1];
    to_send.sigma_velocity_up_mps = sigma_mps[2];
    to_send.range_trust_0 = range_trust[0], to_send.range_trust_1 = range_trust[1];
    to_send.range_trust_2 = range_trust[2], to_send.range_trust_3 = range_trust[3];
    to_send.speed_trust_0 = speed_trust[0], to_send.speed_trust_1 = speed_trust[1];
    to_send.speed_trust_2 = speed_trust[2], to_send.speed_trust_3 = speed_trust[3];
    const size_t length = lidar_encode_navigation(frame, UNIT, &to_send);
    if (write(port, frame, length) == (ssize_t)length)
        sequence = (sequence + 1) % 256;
}

static void beam_axis(size_t k, const lidar_beam *beam, const double *attitude, double *site) {
    const double angle = beam->beam_angle_deg * RAD_PER_DEG, azimuth = AZIMUTH_DEG[k] * RAD_PER_DEG;
    const double body[3] = {sin(angle) * cos(azimuth), sin(angle) * sin(azimuth), cos(angle)};
    rotate(attitude, body, site);
}

/* The speeds of opposite beams have equal sums. Where they differ, the beam that is farthest from the prediction is
 * wrong; BEAMS: none is, or one has no speed. */
static size_t wrong_beam(const lidar_measurement *measurement, const double *attitude) {
    double parity_mps = 0, largest_mps = -1, site[3];
    size_t wrong = BEAMS;
    for (size_t k = 0; k < BEAMS; k++) {
        const lidar_beam *beam = &measurement->beams[k];
        if (k >= measurement->beam_count || !beam->speed_valid || !beam->has_beam_angle_deg)
            return BEAMS;
        beam_axis(k, beam, attitude, site);
        const double along_mps = site[0] * state[0] + site[1] * state[1] + site[2] * state[2];
        const double error_mps = fabs(beam->closing_speed_mps - along_mps);
        parity_mps += k % 2 == 0 ? beam->closing_speed_mps : -beam->closing_speed_mps;
        if (error_mps > largest_mps)
            largest_mps = error_mps, wrong = k;
    }
    return fabs(parity_mps) > PARITY_MPS ? wrong : BEAMS;
}

static void use_beam(size_t k, const lidar_beam *beam, const double *attitude) {
    double site[3];
    beam_axis(k, beam, attitude, site);
    range_trust[k] = speed_trust[k] = INVALID;
    if (!beam->has_beam_angle_deg)
        return;
    if (beam->speed_valid && beam->has_closing_speed_mps) {
        const double design[STATES] = {site[0], site[1], site[2]};
        const double stated_mps = beam->has_sigma_speed_mps ? beam->sigma_speed_mps : 0;
        speed_trust[k] = correct(design, beam->closing_speed_mps, hypot(SPEED_SIGMA_MPS, stated_mps)) ? USED : GATED;
    }
    if (beam->range_valid && beam->has_range_m) {
        const double design[STATES] = {[HEIGHT] = 1}, height_m = -site[2] * beam->range_m;
        const double sigma_m = HEIGHT_SIGMA_M + HEIGHT_SIGMA_SHARE * fabs(height_m);
        range_trust[k] = correct(design, height_m, sigma_m) ? USED : GATED;
    }
}

/* Predict over a silence, by this computer's clock, and say so. */
static void coast(int port, unsigned trust) {
    if (!is_started || now_ns() - state_ns < SILENCE_NS)
        return;
    for (size_t k = 0; k < LIDAR_MAXIMUM_BEAMS; k++)
        range_trust[k] = speed_trust[k] = trust;
    predict(now_ns());
    answer(port, INERTIAL);
}

static void take(int port, const lidar_measurement *measurement) {
    const int64_t time_ns = measurement->shot.time_ns;
    const bool is_set = !is_started || untimely >= MOST_UNTIMELY;
    if (!is_set && (time_ns <= state_ns || time_ns > now_ns() + AHEAD_NS)) {
        untimely++;
        coast(port, UNTIMELY);
        return;
    }
    if (is_set || time_ns > now_ns()) /* the shot with the least delay counts */
        ahead_of_ns += time_ns - now_ns();
    if (is_set)
        start(time_ns);
    untimely = 0;
    predict(time_ns);
    const double *attitude = site_from_body(time_ns);
    const size_t wrong = wrong_beam(measurement, attitude);
    for (size_t k = 0; k < BEAMS && k < measurement->beam_count; k++)
        if (k == wrong)
            range_trust[k] = speed_trust[k] = INCONSISTENT;
        else
            use_beam(k, &measurement->beams[k], attitude);
    answer(port, AIDED);
}

static int open_port(const char *path) {
    struct termios settings;
    const int port = open(path, O_RDWR | O_NOCTTY);
    if (port < 0 || tcgetattr(port, &settings) != 0)
        return -1;
    cfmakeraw(&settings);
    settings.c_cflag |= CLOCAL | CREAD;
    cfsetspeed(&settings, B921600);
    return tcsetattr(port, TCSANOW, &settings) == 0 ? port : -1;
}

int main(int argc, char **argv) {
    static lidar_receiver receiver;
    static lidar_measurement measurement;
    uint8_t bytes[1024];
    unsigned unit;
    if (argc > 2 && !read_motion(argv[2])) {
        fprintf(stderr, "%s: must be a table of lidar-emu simulate, of %d rows at most\n", argv[2], MOST_ROWS);
        return 2;
    }
    const int port = argc > 1 ? open_port(argv[1]) : -1;
    if (port < 0) {
        fprintf(stderr, "usage: navigator PORT [MOTION.csv], a serial port that can be opened\n");
        return 2;
    }
    for (;;) {
        struct pollfd waiting = {.fd = port, .events = POLLIN};
        const ssize_t count = poll(&waiting, 1, 25) > 0 ? read(port, bytes, sizeof bytes) : 0;
        if (waiting.revents != 0 && count <= 0)
            return 0; /* the other side has closed the line */
        for (ssize_t k = 0; k < count; k++) {
            lidar_feed(&receiver, bytes[k]);
            while (lidar_next(&receiver))
                if (lidar_read_measurement(receiver.packet, receiver.packet_length, &unit, &measurement) &&
                    unit == UNIT)
                    take(port, &measurement);
        }
        if (count == 0)
            coast(port, NOT_JUDGED);
    }
}
