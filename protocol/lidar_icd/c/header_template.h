/* The interface "$name", version $version, for its host. Generated from its definition; do not edit.
 *
 * C99, freestanding: no allocation, no library, and of the standard headers stdbool.h, stddef.h and stdint.h alone.
 * On a byte link:
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
 *
 * Options, to be defined before the header is included, alike in all files of a program:
$options
 */
#ifndef LIDAR_INTERFACE_H
#define LIDAR_INTERFACE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef LIDAR_USE_FLOAT
typedef float lidar_real;
#else
typedef double lidar_real;
#endif

typedef enum { LIDAR_NOTHING, LIDAR_MEASUREMENT, LIDAR_ACKNOWLEDGE, LIDAR_HOUSEKEEPING } lidar_kind;

/* Move bytes to the same place or towards lower addresses. */
static inline void lidar_move(void *to, const void *from, size_t count) {
    uint8_t *const target = (uint8_t *)to;
    const uint8_t *const source = (const uint8_t *)from;
    for (size_t k = 0u; k < count; k++)
        target[k] = source[k];
}

static inline void lidar_clear(uint8_t *block, size_t count) {
    for (size_t k = 0u; k < count; k++)
        block[k] = 0u;
}

$bits

static inline int64_t lidar_signed(uint64_t word, unsigned bits) {
    const unsigned sign_bit = bits - 1u;
    const uint64_t sign = (uint64_t)1 << sign_bit, complement = (sign - 1u) - (word & (sign - 1u));
    return (word & sign) != 0u ? -(int64_t)complement - 1 : (int64_t)word;
}

/* Convert a time code of 4 + 3 bytes to nanoseconds. */
static inline int64_t lidar_nanoseconds(uint64_t ticks) {
    const uint64_t fraction = ticks & 0xFFFFFFu;
    const uint64_t time_ns = (ticks >> 24) * 1000000000u + ((fraction * 1000000000u + 0x800000u) >> 24);
    return (int64_t)time_ns;
}

static inline lidar_real lidar_float(uint32_t word) {
    float value;
    lidar_move(&value, &word, sizeof value);
    return (lidar_real)value;
}

static inline double lidar_double(uint64_t word) {
    double value;
    lidar_move(&value, &word, sizeof value);
    return value;
}

$definitions

$crc

$reading

$framing

#endif
