/* The interface "$name", version $version, for its host. Generated from its definition; do not edit.
 *
 * C99, no allocation, standard headers only. On a byte link:
 *
 *     static lidar_receiver receiver;
 *     lidar_feed(&receiver, byte);                        (each received byte)
 *     while (lidar_next(&receiver)) {
 *         unsigned unit;
 *         lidar_measurement shot;
 *         if (lidar_read_measurement(receiver.packet, receiver.packet_length, &unit, &shot)) ...
 *     }
 *
 * receiver.bad_frames counts frames without a valid packet.$command
 * On CAN the identifiers of unit 0 are LIDAR_CAN_ID_...; compare the length of a frame with LIDAR_CAN_..._BYTES and call
 * lidar_unpack_can_...(). A member x has a value if the member has_x, where there is one, is true.
 * Epoch of times: $epoch.
 */
#ifndef LIDAR_INTERFACE_H
#define LIDAR_INTERFACE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef enum { LIDAR_NOTHING, LIDAR_MEASUREMENT, LIDAR_ACKNOWLEDGE, LIDAR_HOUSEKEEPING } lidar_kind;

$bits

static inline int64_t lidar_signed(uint64_t word, unsigned bits) {
    const uint64_t sign = (uint64_t)1 << (bits - 1u);
    return (word & sign) != 0u ? -(int64_t)((sign - 1u) - (word & (sign - 1u))) - 1 : (int64_t)word;
}

/* Convert a time code of 4 + 3 bytes to nanoseconds. */
static inline int64_t lidar_nanoseconds(uint64_t ticks) {
    const uint64_t fraction = ticks & 0xFFFFFFu;
    return (int64_t)((ticks >> 24) * 1000000000u + ((fraction * 1000000000u + 0x800000u) >> 24));
}

static inline double lidar_float(uint32_t word) {
    float value;
    memcpy(&value, &word, sizeof value);
    return (double)value;
}

static inline double lidar_double(uint64_t word) {
    double value;
    memcpy(&value, &word, sizeof value);
    return value;
}

$definitions

$crc

$reading

$framing

#endif
