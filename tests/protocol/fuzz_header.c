/* Feeds lidar.h with damaged frames, with packets of any content under a right CRC, and with blocks of any content, each in
   memory of its very size, so that a sanitizer sees every access beyond it.

   ./fuzz SEED INPUTS < FRAMES: whole frames, one after the other. Prints how many packets and messages it found. */
#include "lidar.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST_BYTES 65536u

static uint64_t state;

static uint64_t any(void) { /* xorshift64 */
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static size_t below(size_t count) { return (size_t)(any() % count); }

static unsigned long long packets, messages;

static void read_packet(const uint8_t *packet, size_t length) {
    static lidar_measurement measurement;
    lidar_acknowledge answer;
    lidar_housekeeping health;
    unsigned unit;
    packets++;
    messages += lidar_read_measurement(packet, length, &unit, &measurement);
    messages += lidar_read_acknowledge(packet, length, &unit, &answer);
    messages += lidar_read_housekeeping(packet, length, &unit, &health);
}

static void damage(uint8_t *data, size_t length) {
    for (size_t k = below(4u); k > 0u; k--)
        data[below(length)] = below(2u) ? (uint8_t)any() : (uint8_t)(data[below(length)] ^ 1u << below(8u));
}

/* A part of the frames, damaged, byte by byte. */
static void feed(const uint8_t *frames, size_t size) {
    static lidar_receiver receiver;
    const size_t start = below(size), length = 1u + below(size - start);
    uint8_t *part = malloc(length);
    memcpy(part, frames + start, length);
    damage(part, length);
    for (size_t k = 0u; k < length; k++) {
        lidar_feed(&receiver, part[k]);
        while (lidar_next(&receiver))
            read_packet(receiver.packet, receiver.packet_length);
    }
    free(part);
}

/* A packet of any content, under a right CRC and mostly a right length. */
static void seal(const uint8_t *frames, size_t size) {
    const size_t start = below(size), length = 9u + below(300u);
    uint8_t *packet = malloc(length);
    for (size_t k = 0u; k < length; k++)
        packet[k] = start + k < size ? frames[start + k] : (uint8_t)any();
    static const uint8_t kinds[] = {0xa0u, 0xb0u, 0xc0u};
    packet[0] = 0x0au;
    packet[1] = (uint8_t)(kinds[below(3u)] | below(16u));
    packet[2] |= 0xc0u;
    packet[4] = (uint8_t)((length - 7u) >> 8u);
    packet[5] = (uint8_t)(length - 7u);
    if (length > 23u) {
        packet[20] = 2u;
        packet[23] = (uint8_t)(below(8u) ? (length - 30u) / 28u : any());
    }
    const uint16_t crc = lidar_crc(0xffffu, packet, length - 2u);
    packet[length - 2u] = (uint8_t)(crc >> 8u);
    packet[length - 1u] = (uint8_t)crc;
    read_packet(packet, length);
    free(packet);
}

static void unstuff(void) {
    const size_t length = below(600u);
    uint8_t *data = malloc(length + 1u), *exact = malloc(length ? length : 1u);
    for (size_t k = 0u; k < length; k++)
        exact[k] = (uint8_t)(below(3u) ? any() : below(8u));
    if (lidar_unstuff(exact, length) > length)
        abort();
    free(data);
    free(exact);
}

/* A block of exactly as many bytes as the message has. */
#define UNPACK(name, bytes) \
    do { \
        lidar_can_##name to; \
        uint8_t *block = malloc(bytes); \
        for (size_t k = 0u; k < (bytes); k++) \
            block[k] = (uint8_t)any(); \
        lidar_unpack_can_##name(block, &to); \
        free(block); \
    } while (0)

static void unpack_can(void) {
    UNPACK(header, LIDAR_CAN_HEADER_BYTES);
    UNPACK(status, LIDAR_CAN_STATUS_BYTES);
    UNPACK(shot, LIDAR_CAN_SHOT_BYTES);
    UNPACK(beam, LIDAR_CAN_BEAM_BYTES);
    UNPACK(quality, LIDAR_CAN_QUALITY_BYTES);
    UNPACK(geometry, LIDAR_CAN_GEOMETRY_BYTES);
    UNPACK(fd_header, LIDAR_CAN_FD_HEADER_BYTES);
    UNPACK(fd_beam, LIDAR_CAN_FD_BEAM_BYTES);
}

int main(int count, char **values) {
    static uint8_t frames[MOST_BYTES];
    const size_t size = fread(frames, 1u, MOST_BYTES, stdin);
    if (count != 3 || size == 0u)
        return 2;
    state = strtoull(values[1], NULL, 10) * 0x9e3779b97f4a7c15u + 1u;
    for (unsigned long long left = strtoull(values[2], NULL, 10); left > 0u; left--) {
        switch (below(4u)) {
        case 0u: feed(frames, size); break;
        case 1u: seal(frames, size); break;
        case 2u: unstuff(); break;
        default: unpack_can();
        }
    }
    printf("%llu %llu\n", packets, messages);
    return 0;
}
