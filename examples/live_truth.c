/* A minimal dynamics simulator in C: it flies a descent and waits, after each truth, for the reply of the lidar.
 *
 *     cc -std=c99 live_truth.c -o live_truth
 *     lidar-emu run live.yaml --pace lockstep
 *     ./live_truth [port]
 *
 * A simulator needs lidar_truth.h and lidar_truth_link.h. Little-endian machines, POSIX. */
#define _POSIX_C_SOURCE 200809L
#include "lidar_truth_link.h"

enum { RATE_HZ = 100, DURATION_S = 40 };

/* From 1000 m, descending at 40 m/s, decelerating by 0.8 m/s2; body z down, x north. */
static void fly(struct lidar_truth *truth, double time_s) {
    const double root = 0.70710678118654752;
    truth->flags |= LIDAR_TRUTH_ACCELERATION_KNOWN;
    truth->position_site_m[2] = 1000 - 40 * time_s + 0.4 * time_s * time_s;
    truth->velocity_site_mps[2] = -40 + 0.8 * time_s;
    truth->acceleration_site_mps2[2] = 0.8;
    truth->site_from_body[0] = truth->site_from_body[3] = 0;
    truth->site_from_body[1] = truth->site_from_body[2] = root;
}

int main(int count, char **arguments) {
    const int link = lidar_truth_open((uint16_t)(count > 1 ? atoi(arguments[1]) : 5600));
    if (link < 0)
        return 1;
    long packets = 0;
    for (uint32_t step = 0; step <= RATE_HZ * DURATION_S; step++) {
        struct lidar_truth truth;
        lidar_truth_begin(&truth, step, (int64_t)step * (1000000000 / RATE_HZ));
        fly(&truth, (double)step / RATE_HZ);
        if (step == RATE_HZ * DURATION_S)
            truth.flags |= LIDAR_TRUTH_LAST;
        long more = lidar_truth_send_and_wait(link, &truth);
        if (more < 0)
            return 1;
        packets += more;
    }
    printf("%d truths, %ld packets in the replies\n", RATE_HZ * DURATION_S + 1, packets);
    close(link);
    return 0;
}
