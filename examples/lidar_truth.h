/* Truth for an emulated lidar (lidar-emu, live truth version 1): fill one in and send it as a datagram.
 * On a little-endian machine the structure is the datagram; docs/live-truth.md defines the fields. */
#ifndef LIDAR_TRUTH_H
#define LIDAR_TRUTH_H

#include <stdint.h>
#include <string.h>

enum { LIDAR_TRUTH_ACCELERATION_KNOWN = 1, LIDAR_TRUTH_LAST = 2 };

struct lidar_truth {
    char magic[4];                    /* "LETR" */
    uint16_t version;                 /* 1 */
    uint16_t flags;
    uint32_t sequence;                /* one more with each datagram */
    uint32_t spare;
    int64_t time_ns;                  /* scenario time */
    double position_site_m[3];        /* east, north, up */
    double velocity_site_mps[3];
    double acceleration_site_mps2[3];
    double site_from_body[4];         /* unit quaternion, scalar first; body x forward, y right, z down */
    double body_rate_radps[3];        /* about body x, y, z */
};

typedef char lidar_truth_is_152_bytes[sizeof(struct lidar_truth) == 152 ? 1 : -1];

static inline void lidar_truth_begin(struct lidar_truth *truth, uint32_t sequence, int64_t time_ns) {
    memset(truth, 0, sizeof *truth);
    memcpy(truth->magic, "LETR", 4);
    truth->version = 1;
    truth->sequence = sequence;
    truth->time_ns = time_ns;
    truth->site_from_body[0] = 1.0;
}

#endif
