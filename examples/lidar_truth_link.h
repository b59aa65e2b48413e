/* The link to an emulated lidar in lockstep: each truth is sent and its reply awaited. Little-endian machines, POSIX;
 * define _POSIX_C_SOURCE 200809L before any header. */
#ifndef LIDAR_TRUTH_LINK_H
#define LIDAR_TRUTH_LINK_H

#include "lidar_truth.h"

#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum { LIDAR_TRUTH_ATTEMPTS = 600, LIDAR_TRUTH_REPLY_HEAD_BYTES = 24 };

/* Open the link to a lidar on this machine; return a socket, -1 with a message if there is none. */
static inline int lidar_truth_open(uint16_t port) {
    const struct timeval limit = {1, 0};
    struct sockaddr_in lidar = {0};
    lidar.sin_family = AF_INET;
    lidar.sin_port = htons(port);
    lidar.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int link = socket(AF_INET, SOCK_DGRAM, 0);
    if (link < 0 || connect(link, (struct sockaddr *)&lidar, sizeof lidar) != 0 ||
        setsockopt(link, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit) != 0) {
        perror("socket");
        return -1;
    }
    return link;
}

/* Receive the reply to a truth, whose datagrams count down; return the number of its packets, -1 if it did not come
 * whole, -2 with a message if the truth was refused. */
static inline long lidar_truth_receive_reply(int link, uint32_t sequence) {
    static unsigned char data[65536];
    long packets = 0;
    int follow = -1;
    while (follow != 0) {
        uint32_t answered, count;
        ssize_t length = recv(link, data, sizeof data, 0);
        if (length < LIDAR_TRUTH_REPLY_HEAD_BYTES || memcmp(data, "LEAN", 4) != 0)
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

/* Send a truth until the lidar replies: it may not have begun, and datagrams can be lost. Return the number of packets
 * in the reply, -2 with a message if there is none. */
static inline long lidar_truth_send_and_wait(int link, const struct lidar_truth *truth) {
    const struct timespec pause = {0, 100000000};
    for (int attempt = 0; attempt < LIDAR_TRUTH_ATTEMPTS; attempt++) {
        long packets =
            send(link, truth, sizeof *truth, 0) < 0 ? -1 : lidar_truth_receive_reply(link, truth->sequence);
        if (packets != -1)
            return packets;
        nanosleep(&pause, NULL);
    }
    fprintf(stderr, "the lidar does not reply\n");
    return -2;
}

#endif
