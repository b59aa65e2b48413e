/* A minimal dynamics simulator in C: it flies a descent and waits, after each truth, for the reply of the lidar.
 *
 *     cc -std=c99 live_truth.c -o live_truth
 *     lidar-emu run live.yaml --pace lockstep
 *     ./live_truth [port]
 *
 * A simulator's own job needs `send_and_wait` and `struct lidar_truth`. Little-endian machines, POSIX. */
#define _POSIX_C_SOURCE 200809L
#include "lidar_truth.h"

#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum { RATE_HZ = 100, DURATION_S = 40, ATTEMPTS = 600, HEAD_BYTES = 24 };

/* Receive the reply to a truth, whose datagrams count down; return the number of its packets, -1 if it did not come
 * whole, -2 if the truth was refused. */
static long receive_reply(int link, uint32_t sequence) {
    static unsigned char data[65536];
    long packets = 0;
    int follow = -1;
    while (follow != 0) {
        uint32_t answered, count;
        ssize_t length = recv(link, data, sizeof data, 0);
        if (length < HEAD_BYTES || memcmp(data, "LEAN", 4) != 0)
            return -1;
        memcpy(&answered, data + 8, 4);
        memcpy(&count, data + 12, 4);
        if (answered != sequence)
            continue; /* the reply to a truth that was sent twice */
        if (data[6] != 0) {
            fprintf(stderr, "truth %u was refused: status %d\n", (unsigned)sequence, data[6]);
            return -2;
        }
        if (follow > 0 && data[7] != 255 && data[7] != follow - 1)
            return -1; /* a part of the reply was lost */
        follow = data[7];
        packets += (long)count; /* each begins at data + 24: see docs/live-truth.md */
    }
    return packets;
}

/* Send a truth until the lidar replies: it may not have begun, and datagrams can be lost. */
static long send_and_wait(int link, const struct lidar_truth *truth) {
    const struct timespec pause = {0, 100000000};
    for (int attempt = 0; attempt < ATTEMPTS; attempt++) {
        long packets = send(link, truth, sizeof *truth, 0) < 0 ? -1 : receive_reply(link, truth->sequence);
        if (packets != -1)
            return packets;
        nanosleep(&pause, NULL);
    }
    fprintf(stderr, "the lidar does not reply\n");
    return -2;
}

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
    const struct timeval limit = {1, 0};
    struct sockaddr_in lidar = {0};
    lidar.sin_family = AF_INET;
    lidar.sin_port = htons((uint16_t)(count > 1 ? atoi(arguments[1]) : 5600));
    lidar.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int link = socket(AF_INET, SOCK_DGRAM, 0);
    if (link < 0 || connect(link, (struct sockaddr *)&lidar, sizeof lidar) != 0 ||
        setsockopt(link, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit) != 0) {
        perror("socket");
        return 1;
    }
    long packets = 0;
    for (uint32_t step = 0; step <= RATE_HZ * DURATION_S; step++) {
        struct lidar_truth truth;
        lidar_truth_begin(&truth, step, (int64_t)step * (1000000000 / RATE_HZ));
        fly(&truth, (double)step / RATE_HZ);
        if (step == RATE_HZ * DURATION_S)
            truth.flags |= LIDAR_TRUTH_LAST;
        long more = send_and_wait(link, &truth);
        if (more < 0)
            return 1;
        packets += more;
    }
    printf("%d truths, %ld packets in the replies\n", RATE_HZ * DURATION_S + 1, packets);
    close(link);
    return 0;
}
