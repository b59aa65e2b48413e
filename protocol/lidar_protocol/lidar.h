/* The interface "lidar-emu", version 3, for its host. Generated from its definition; do not edit.
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
 * receiver.bad_frames counts frames without a valid packet.
 *
 * lidar_encode_...(frame, unit, sequence, ...) writes a framed command to `frame`, a buffer of
 * LIDAR_LONGEST_COMMAND bytes, and returns the number of bytes: 0 if an argument is out of range.
 *
 * lidar_encode_...(frame, unit, &message) does so with another message, in a buffer of LIDAR_LONGEST_MESSAGE bytes.
 * On CAN lidar_pack_can_...(data, &message) fills one of its frames, all of which are sent, in the order of their
 * functions.
 *
 * On CAN the identifiers of unit 0 are LIDAR_CAN_ID_...; compare the length of a frame with LIDAR_CAN_..._BYTES and call
 * lidar_unpack_can_...(). A member x has a value if the member has_x, where there is one, is true.
 * Epoch of times: the instant agreed for the run (key timing.epoch of the emulator's scenario), on a scale without leap seconds.
 *
 * Options, to be defined before the header is included, alike in all files of a program:
 * LIDAR_MAXIMUM_BEAMS: 1 to 64. Measurement and receiver shrink with it; packets of more beams are refused.
 * LIDAR_USE_FLOAT: lidar_real is float instead of double.
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

static inline uint64_t lidar_bits(const uint8_t *block, size_t first_bit, unsigned bits) {
    uint64_t word = 0u;
    for (size_t k = first_bit; k < first_bit + bits; k++)
        word = word << 1 | ((uint64_t)block[k / 8u] >> (7u - k % 8u) & 1u);
    return word;
}

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

#define LIDAR_INTERFACE_VERSION 3u
#define LIDAR_UNITS 16u
#ifndef LIDAR_MAXIMUM_BEAMS
#define LIDAR_MAXIMUM_BEAMS 64u
#endif
#if LIDAR_MAXIMUM_BEAMS < 1 || LIDAR_MAXIMUM_BEAMS > 64u
#error "LIDAR_MAXIMUM_BEAMS must be 1 to 64"
#endif
#define LIDAR_HEADER_BYTES 6u
#define LIDAR_CRC_BYTES 2u
#define LIDAR_LONGEST_BODY ((LIDAR_SHOT_BYTES + LIDAR_MAXIMUM_BEAMS * LIDAR_BEAM_BYTES) > 41u ? (LIDAR_SHOT_BYTES + LIDAR_MAXIMUM_BEAMS * LIDAR_BEAM_BYTES) : 41u)
#define LIDAR_LONGEST_PACKET (LIDAR_HEADER_BYTES + LIDAR_LONGEST_BODY + LIDAR_CRC_BYTES)
#define LIDAR_LONGEST_FRAME (LIDAR_LONGEST_PACKET + 1u + (LIDAR_LONGEST_PACKET - 1u) / 254u)
#define LIDAR_CAN_UNIT_STRIDE 0x40u
#define LIDAR_CAN_BEAM_SLOTS 8u
#define LIDAR_CAN_ID_HEADER 0x100u
#define LIDAR_CAN_ID_STATUS 0x101u
#define LIDAR_CAN_ID_SHOT 0x102u
#define LIDAR_CAN_ID_BEAM 0x108u
#define LIDAR_CAN_ID_QUALITY 0x110u
#define LIDAR_CAN_ID_GEOMETRY 0x118u
#define LIDAR_CAN_ID_FD_HEADER 0x120u
#define LIDAR_CAN_ID_FD_BEAM 0x128u
#define LIDAR_CAN_ID_ACKNOWLEDGE 0x138u
#define LIDAR_CAN_ID_HEALTH 0x139u
#define LIDAR_CAN_ID_AGE 0x13Au
#define LIDAR_CAN_ID_SHOTS_LOST 0x13Bu
#define LIDAR_CAN_ID_COMMANDS_LOST 0x13Cu
#define LIDAR_CAN_ID_VERSIONS 0x13Du

#define LIDAR_MODE_OFF 0u
#define LIDAR_MODE_STANDBY 1u
#define LIDAR_MODE_SELF_TEST 2u
#define LIDAR_MODE_ACQUIRE 3u
#define LIDAR_MODE_TRACK 4u
#define LIDAR_MODE_FAULT 5u
#define LIDAR_MODE_SAFE 6u
#define LIDAR_REASON_VALID 0u
#define LIDAR_REASON_NOT_FIRED 1u
#define LIDAR_REASON_NO_SURFACE 2u
#define LIDAR_REASON_BELOW_THRESHOLD 3u
#define LIDAR_REASON_BEYOND_RANGE 4u
#define LIDAR_REASON_INSIDE_GROUND 5u
#define LIDAR_REASON_AMBIGUOUS 6u
#define LIDAR_SEGMENTS_NONE 0u
#define LIDAR_SEGMENTS_UP 1u
#define LIDAR_SEGMENTS_CONSTANT 2u
#define LIDAR_SEGMENTS_UP_CONSTANT 3u
#define LIDAR_SEGMENTS_DOWN 4u
#define LIDAR_SEGMENTS_UP_DOWN 5u
#define LIDAR_SEGMENTS_CONSTANT_DOWN 6u
#define LIDAR_SEGMENTS_UP_CONSTANT_DOWN 7u
#define LIDAR_VERDICT_ACCEPTED 0u
#define LIDAR_VERDICT_UNKNOWN 1u
#define LIDAR_VERDICT_MALFORMED 2u
#define LIDAR_VERDICT_BAD_SEQUENCE 3u
#define LIDAR_VERDICT_OUT_OF_STATE 4u
#define LIDAR_VERDICT_OUT_OF_RANGE 5u
#define LIDAR_NAVIGATION_MODE_OFF 0u
#define LIDAR_NAVIGATION_MODE_ALIGNMENT 1u
#define LIDAR_NAVIGATION_MODE_INERTIAL 2u
#define LIDAR_NAVIGATION_MODE_AIDED 3u
#define LIDAR_NAVIGATION_MODE_REINITIALISED 4u
#define LIDAR_NAVIGATION_MODE_FAILED 5u
#define LIDAR_TRUST_NOT_JUDGED 0u
#define LIDAR_TRUST_USED 1u
#define LIDAR_TRUST_INVALID 2u
#define LIDAR_TRUST_GATED 3u
#define LIDAR_TRUST_INCONSISTENT 4u
#define LIDAR_TRUST_UNTIMELY 5u
#define LIDAR_TRUST_EXCLUDED 6u
#define LIDAR_RESTART_WARM 0u
#define LIDAR_RESTART_COLD 1u
#define LIDAR_COMMAND_NO_OP 0u
#define LIDAR_COMMAND_SET_MODE 1u
#define LIDAR_COMMAND_SET_PATTERN 2u
#define LIDAR_COMMAND_SET_RATE_HZ 3u
#define LIDAR_COMMAND_ENABLE_BEAMS 4u
#define LIDAR_COMMAND_TIME_AT_TONE 5u
#define LIDAR_COMMAND_SET_PARAMETER 6u
#define LIDAR_COMMAND_RESET 7u
#define LIDAR_COMMAND_NAVIGATION 16u

#define LIDAR_SHOT_BYTES 23u

typedef struct {
    int64_t time_ns;
    int64_t due_ns;
    uint64_t interface_version;
    uint64_t mode;
    bool laser_on;
    bool clock_locked;
    uint64_t beam_count;
    bool has_beam_count;
    uint64_t shot;
    uint64_t pattern;
} lidar_shot;

static inline void lidar_unpack_shot(const uint8_t *block, lidar_shot *to) {
    to->time_ns = lidar_nanoseconds(lidar_bits(block, 0u, 56u));
    to->due_ns = lidar_nanoseconds(lidar_bits(block, 56u, 56u));
    { const uint64_t raw = lidar_bits(block, 112u, 8u);
      to->interface_version = raw; }
    { const uint64_t raw = lidar_bits(block, 120u, 8u);
      to->mode = raw; }
    to->laser_on = lidar_bits(block, 134u, 1u) != 0u;
    to->clock_locked = lidar_bits(block, 135u, 1u) != 0u;
    { const uint64_t raw = lidar_bits(block, 136u, 8u);
      to->has_beam_count = raw >= 1ULL && raw <= 64ULL;
      to->beam_count = raw; }
    to->shot = lidar_bits(block, 144u, 32u);
    { const uint64_t raw = lidar_bits(block, 176u, 8u);
      to->pattern = raw; }
}

#define LIDAR_BEAM_BYTES 31u

typedef struct {
    bool fired;
    bool range_valid;
    bool speed_valid;
    bool sign_resolved;
    uint64_t segments;
    uint64_t reason;
    uint64_t returns;
    lidar_real snr_db; /* dB */
    bool has_snr_db;
    lidar_real range_m; /* m */
    bool has_range_m;
    lidar_real closing_speed_mps; /* m/s */
    bool has_closing_speed_mps;
    lidar_real second_range_m; /* m */
    bool has_second_range_m;
    lidar_real sigma_range_m; /* m */
    bool has_sigma_range_m;
    lidar_real sigma_speed_mps; /* m/s */
    bool has_sigma_speed_mps;
    lidar_real residual_mps; /* m/s */
    bool has_residual_mps;
    lidar_real beam_angle_deg; /* deg */
    bool has_beam_angle_deg;
    lidar_real time_offset_s; /* s */
    bool has_time_offset_s;
    lidar_real second_sigma_range_m; /* m */
    bool has_second_sigma_range_m;
    uint64_t second_reason;
} lidar_beam;

static inline void lidar_unpack_beam(const uint8_t *block, lidar_beam *to) {
    to->fired = lidar_bits(block, 0u, 1u) != 0u;
    to->range_valid = lidar_bits(block, 1u, 1u) != 0u;
    to->speed_valid = lidar_bits(block, 2u, 1u) != 0u;
    to->sign_resolved = lidar_bits(block, 3u, 1u) != 0u;
    { const uint64_t raw = lidar_bits(block, 5u, 3u);
      to->segments = raw; }
    { const uint64_t raw = lidar_bits(block, 8u, 4u);
      to->reason = raw; }
    { const uint64_t raw = lidar_bits(block, 12u, 4u);
      to->returns = raw; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 16u, 16u), 16u);
      to->has_snr_db = raw >= -32767LL && raw <= 32767LL;
      to->snr_db = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 32u, 32u);
      to->has_range_m = raw <= 4294967294ULL;
      to->range_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 64u, 32u), 32u);
      to->has_closing_speed_mps = raw >= -2147483647LL && raw <= 2147483647LL;
      to->closing_speed_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 96u, 32u);
      to->has_second_range_m = raw <= 4294967294ULL;
      to->second_range_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 128u, 16u);
      to->has_sigma_range_m = raw <= 65534ULL;
      to->sigma_range_m = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 144u, 16u);
      to->has_sigma_speed_mps = raw <= 65534ULL;
      to->sigma_speed_mps = (lidar_real)raw / (lidar_real)100000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 160u, 16u), 16u);
      to->has_residual_mps = raw >= -32767LL && raw <= 32767LL;
      to->residual_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 176u, 16u);
      to->has_beam_angle_deg = raw <= 9000ULL;
      to->beam_angle_deg = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 192u, 32u);
      to->has_time_offset_s = raw <= 4294967294ULL;
      to->time_offset_s = (lidar_real)raw / (lidar_real)1000000.0; }
    { const uint64_t raw = lidar_bits(block, 224u, 16u);
      to->has_second_sigma_range_m = raw <= 65534ULL;
      to->second_sigma_range_m = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 244u, 4u);
      to->second_reason = raw; }
}

#define LIDAR_ACKNOWLEDGE_BYTES 10u

typedef struct {
    int64_t time_ns;
    uint64_t command;
    uint64_t sequence;
    uint64_t verdict;
} lidar_acknowledge;

static inline void lidar_unpack_acknowledge(const uint8_t *block, lidar_acknowledge *to) {
    to->time_ns = lidar_nanoseconds(lidar_bits(block, 0u, 56u));
    { const uint64_t raw = lidar_bits(block, 56u, 8u);
      to->command = raw; }
    { const uint64_t raw = lidar_bits(block, 64u, 8u);
      to->sequence = raw; }
    { const uint64_t raw = lidar_bits(block, 72u, 8u);
      to->verdict = raw; }
}

#define LIDAR_HOUSEKEEPING_BYTES 41u

typedef struct {
    int64_t time_ns;
    uint64_t interface_version;
    uint64_t software_major;
    uint64_t software_minor;
    uint64_t software_patch;
    uint64_t mode;
    bool interlock_closed;
    bool laser_on;
    bool clock_locked;
    lidar_real temperature_c; /* degC */
    bool has_temperature_c;
    lidar_real laser_power_w; /* W */
    bool has_laser_power_w;
    uint64_t uptime_s; /* s */
    bool has_uptime_s;
    uint64_t shots_dropped;
    uint64_t shots_late;
    uint64_t commands_accepted;
    uint64_t commands_rejected;
    uint64_t bad_bytes;
    lidar_real truth_age_s; /* s */
    bool has_truth_age_s;
} lidar_housekeeping;

static inline void lidar_unpack_housekeeping(const uint8_t *block, lidar_housekeeping *to) {
    to->time_ns = lidar_nanoseconds(lidar_bits(block, 0u, 56u));
    { const uint64_t raw = lidar_bits(block, 56u, 8u);
      to->interface_version = raw; }
    { const uint64_t raw = lidar_bits(block, 64u, 8u);
      to->software_major = raw; }
    { const uint64_t raw = lidar_bits(block, 72u, 8u);
      to->software_minor = raw; }
    { const uint64_t raw = lidar_bits(block, 80u, 8u);
      to->software_patch = raw; }
    { const uint64_t raw = lidar_bits(block, 88u, 8u);
      to->mode = raw; }
    to->interlock_closed = lidar_bits(block, 101u, 1u) != 0u;
    to->laser_on = lidar_bits(block, 102u, 1u) != 0u;
    to->clock_locked = lidar_bits(block, 103u, 1u) != 0u;
    { const int64_t raw = lidar_signed(lidar_bits(block, 104u, 16u), 16u);
      to->has_temperature_c = raw >= -32767LL && raw <= 32767LL;
      to->temperature_c = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 120u, 16u);
      to->has_laser_power_w = raw <= 65534ULL;
      to->laser_power_w = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 136u, 32u);
      to->has_uptime_s = raw <= 4294967294ULL;
      to->uptime_s = raw; }
    to->shots_dropped = lidar_bits(block, 168u, 32u);
    to->shots_late = lidar_bits(block, 200u, 32u);
    to->commands_accepted = lidar_bits(block, 232u, 16u);
    to->commands_rejected = lidar_bits(block, 248u, 16u);
    to->bad_bytes = lidar_bits(block, 264u, 32u);
    { const uint64_t raw = lidar_bits(block, 296u, 32u);
      to->has_truth_age_s = raw <= 4294967294ULL;
      to->truth_age_s = (lidar_real)raw / (lidar_real)1000000.0; }
}

#define LIDAR_CAN_HEADER_BYTES 8u

typedef struct {
    uint64_t shot_counter;
    bool details;
    int64_t beam_count;
    int64_t time_ns;
} lidar_can_header;

static inline void lidar_unpack_can_header(const uint8_t *block, lidar_can_header *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    to->details = lidar_bits(block, 4u, 1u) != 0u;
    { const uint64_t raw = lidar_bits(block, 5u, 3u);
      to->beam_count = (int64_t)raw + 1; }
    to->time_ns = lidar_nanoseconds(lidar_bits(block, 8u, 56u));
}

#define LIDAR_CAN_STATUS_BYTES 8u

typedef struct {
    uint64_t shot_counter;
    bool laser_on;
    bool clock_locked;
    int64_t due_ns;
} lidar_can_status;

static inline void lidar_unpack_can_status(const uint8_t *block, lidar_can_status *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    to->laser_on = lidar_bits(block, 6u, 1u) != 0u;
    to->clock_locked = lidar_bits(block, 7u, 1u) != 0u;
    to->due_ns = lidar_nanoseconds(lidar_bits(block, 8u, 56u));
}

#define LIDAR_CAN_SHOT_BYTES 7u

typedef struct {
    uint64_t shot_counter;
    uint64_t mode;
    uint64_t interface_version;
    uint64_t shot;
    uint64_t pattern;
} lidar_can_shot;

static inline void lidar_unpack_can_shot(const uint8_t *block, lidar_can_shot *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    { const uint64_t raw = lidar_bits(block, 4u, 4u);
      to->mode = raw; }
    { const uint64_t raw = lidar_bits(block, 8u, 8u);
      to->interface_version = raw; }
    to->shot = lidar_bits(block, 16u, 32u);
    { const uint64_t raw = lidar_bits(block, 48u, 8u);
      to->pattern = raw; }
}

#define LIDAR_CAN_BEAM_BYTES 8u

typedef struct {
    uint64_t shot_counter;
    bool range_valid;
    bool speed_valid;
    bool sign_resolved;
    uint64_t segments;
    lidar_real snr_db; /* dB */
    bool has_snr_db;
    lidar_real range_m; /* m */
    bool has_range_m;
    lidar_real closing_speed_mps; /* m/s */
    bool has_closing_speed_mps;
} lidar_can_beam;

static inline void lidar_unpack_can_beam(const uint8_t *block, lidar_can_beam *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    to->range_valid = lidar_bits(block, 4u, 1u) != 0u;
    to->speed_valid = lidar_bits(block, 5u, 1u) != 0u;
    to->sign_resolved = lidar_bits(block, 6u, 1u) != 0u;
    { const uint64_t raw = lidar_bits(block, 7u, 3u);
      to->segments = raw; }
    { const uint64_t raw = lidar_bits(block, 10u, 6u);
      to->has_snr_db = raw <= 62ULL;
      to->snr_db = (lidar_real)raw / (lidar_real)1.0; }
    { const uint64_t raw = lidar_bits(block, 16u, 24u);
      to->has_range_m = raw <= 16777213ULL;
      to->range_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 40u, 24u), 24u);
      to->has_closing_speed_mps = raw >= -8388606LL && raw <= 8388607LL;
      to->closing_speed_mps = (lidar_real)raw / (lidar_real)10000.0; }
}

#define LIDAR_CAN_QUALITY_BYTES 8u

typedef struct {
    uint64_t shot_counter;
    uint64_t reason;
    uint64_t returns;
    uint64_t second_reason;
    lidar_real sigma_range_m; /* m */
    bool has_sigma_range_m;
    lidar_real sigma_speed_mps; /* m/s */
    bool has_sigma_speed_mps;
    lidar_real residual_mps; /* m/s */
    bool has_residual_mps;
} lidar_can_quality;

static inline void lidar_unpack_can_quality(const uint8_t *block, lidar_can_quality *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    { const uint64_t raw = lidar_bits(block, 4u, 4u);
      to->reason = raw; }
    { const uint64_t raw = lidar_bits(block, 8u, 4u);
      to->returns = raw; }
    { const uint64_t raw = lidar_bits(block, 12u, 4u);
      to->second_reason = raw; }
    { const uint64_t raw = lidar_bits(block, 16u, 16u);
      to->has_sigma_range_m = raw <= 65534ULL;
      to->sigma_range_m = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 32u, 16u);
      to->has_sigma_speed_mps = raw <= 65534ULL;
      to->sigma_speed_mps = (lidar_real)raw / (lidar_real)100000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 48u, 16u), 16u);
      to->has_residual_mps = raw >= -32767LL && raw <= 32767LL;
      to->residual_mps = (lidar_real)raw / (lidar_real)10000.0; }
}

#define LIDAR_CAN_GEOMETRY_BYTES 8u

typedef struct {
    uint64_t shot_counter;
    lidar_real time_offset_s; /* s */
    bool has_time_offset_s;
    lidar_real beam_angle_deg; /* deg */
    bool has_beam_angle_deg;
    lidar_real second_range_m; /* m */
    bool has_second_range_m;
    lidar_real second_sigma_range_m; /* m */
    bool has_second_sigma_range_m;
} lidar_can_geometry;

static inline void lidar_unpack_can_geometry(const uint8_t *block, lidar_can_geometry *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    { const uint64_t raw = lidar_bits(block, 4u, 17u);
      to->has_time_offset_s = raw <= 131070ULL;
      to->time_offset_s = (lidar_real)raw / (lidar_real)1000000.0; }
    { const uint64_t raw = lidar_bits(block, 21u, 14u);
      to->has_beam_angle_deg = raw <= 9000ULL;
      to->beam_angle_deg = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 35u, 21u);
      to->has_second_range_m = raw <= 2097150ULL;
      to->second_range_m = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 56u, 8u);
      to->has_second_sigma_range_m = raw <= 254ULL;
      to->second_sigma_range_m = (lidar_real)raw / (lidar_real)200.0; }
}

#define LIDAR_CAN_FD_HEADER_BYTES 24u

typedef struct {
    uint64_t shot_counter;
    int64_t time_ns;
    int64_t due_ns;
    uint64_t interface_version;
    uint64_t mode;
    bool laser_on;
    bool clock_locked;
    uint64_t beam_count;
    bool has_beam_count;
    uint64_t shot;
    uint64_t pattern;
} lidar_can_fd_header;

static inline void lidar_unpack_can_fd_header(const uint8_t *block, lidar_can_fd_header *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    to->time_ns = lidar_nanoseconds(lidar_bits(block, 8u, 56u));
    to->due_ns = lidar_nanoseconds(lidar_bits(block, 64u, 56u));
    { const uint64_t raw = lidar_bits(block, 120u, 8u);
      to->interface_version = raw; }
    { const uint64_t raw = lidar_bits(block, 128u, 8u);
      to->mode = raw; }
    to->laser_on = lidar_bits(block, 142u, 1u) != 0u;
    to->clock_locked = lidar_bits(block, 143u, 1u) != 0u;
    { const uint64_t raw = lidar_bits(block, 144u, 8u);
      to->has_beam_count = raw >= 1ULL && raw <= 8ULL;
      to->beam_count = raw; }
    to->shot = lidar_bits(block, 152u, 32u);
    { const uint64_t raw = lidar_bits(block, 184u, 8u);
      to->pattern = raw; }
}

#define LIDAR_CAN_FD_BEAM_BYTES 32u

typedef struct {
    uint64_t shot_counter;
    bool fired;
    bool range_valid;
    bool speed_valid;
    bool sign_resolved;
    uint64_t segments;
    uint64_t reason;
    uint64_t returns;
    lidar_real snr_db; /* dB */
    bool has_snr_db;
    lidar_real range_m; /* m */
    bool has_range_m;
    lidar_real closing_speed_mps; /* m/s */
    bool has_closing_speed_mps;
    lidar_real second_range_m; /* m */
    bool has_second_range_m;
    lidar_real sigma_range_m; /* m */
    bool has_sigma_range_m;
    lidar_real sigma_speed_mps; /* m/s */
    bool has_sigma_speed_mps;
    lidar_real residual_mps; /* m/s */
    bool has_residual_mps;
    lidar_real beam_angle_deg; /* deg */
    bool has_beam_angle_deg;
    lidar_real time_offset_s; /* s */
    bool has_time_offset_s;
    lidar_real second_sigma_range_m; /* m */
    bool has_second_sigma_range_m;
    uint64_t second_reason;
} lidar_can_fd_beam;

static inline void lidar_unpack_can_fd_beam(const uint8_t *block, lidar_can_fd_beam *to) {
    to->shot_counter = lidar_bits(block, 0u, 4u);
    to->fired = lidar_bits(block, 8u, 1u) != 0u;
    to->range_valid = lidar_bits(block, 9u, 1u) != 0u;
    to->speed_valid = lidar_bits(block, 10u, 1u) != 0u;
    to->sign_resolved = lidar_bits(block, 11u, 1u) != 0u;
    { const uint64_t raw = lidar_bits(block, 13u, 3u);
      to->segments = raw; }
    { const uint64_t raw = lidar_bits(block, 16u, 4u);
      to->reason = raw; }
    { const uint64_t raw = lidar_bits(block, 20u, 4u);
      to->returns = raw; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 24u, 16u), 16u);
      to->has_snr_db = raw >= -32767LL && raw <= 32767LL;
      to->snr_db = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 40u, 32u);
      to->has_range_m = raw <= 4294967294ULL;
      to->range_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 72u, 32u), 32u);
      to->has_closing_speed_mps = raw >= -2147483647LL && raw <= 2147483647LL;
      to->closing_speed_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 104u, 32u);
      to->has_second_range_m = raw <= 4294967294ULL;
      to->second_range_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 136u, 16u);
      to->has_sigma_range_m = raw <= 65534ULL;
      to->sigma_range_m = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 152u, 16u);
      to->has_sigma_speed_mps = raw <= 65534ULL;
      to->sigma_speed_mps = (lidar_real)raw / (lidar_real)100000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 168u, 16u), 16u);
      to->has_residual_mps = raw >= -32767LL && raw <= 32767LL;
      to->residual_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 184u, 16u);
      to->has_beam_angle_deg = raw <= 9000ULL;
      to->beam_angle_deg = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 200u, 32u);
      to->has_time_offset_s = raw <= 4294967294ULL;
      to->time_offset_s = (lidar_real)raw / (lidar_real)1000000.0; }
    { const uint64_t raw = lidar_bits(block, 232u, 16u);
      to->has_second_sigma_range_m = raw <= 65534ULL;
      to->second_sigma_range_m = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 252u, 4u);
      to->second_reason = raw; }
}

#define LIDAR_CAN_ACKNOWLEDGE_BYTES 3u

typedef struct {
    uint64_t command;
    uint64_t sequence;
    uint64_t verdict;
} lidar_can_acknowledge;

static inline void lidar_unpack_can_acknowledge(const uint8_t *block, lidar_can_acknowledge *to) {
    { const uint64_t raw = lidar_bits(block, 0u, 8u);
      to->command = raw; }
    { const uint64_t raw = lidar_bits(block, 8u, 8u);
      to->sequence = raw; }
    { const uint64_t raw = lidar_bits(block, 16u, 8u);
      to->verdict = raw; }
}

#define LIDAR_CAN_HEALTH_BYTES 6u

typedef struct {
    uint64_t mode;
    bool interlock_closed;
    bool laser_on;
    bool clock_locked;
    lidar_real temperature_c; /* degC */
    bool has_temperature_c;
    lidar_real laser_power_w; /* W */
    bool has_laser_power_w;
} lidar_can_health;

static inline void lidar_unpack_can_health(const uint8_t *block, lidar_can_health *to) {
    { const uint64_t raw = lidar_bits(block, 0u, 8u);
      to->mode = raw; }
    to->interlock_closed = lidar_bits(block, 13u, 1u) != 0u;
    to->laser_on = lidar_bits(block, 14u, 1u) != 0u;
    to->clock_locked = lidar_bits(block, 15u, 1u) != 0u;
    { const int64_t raw = lidar_signed(lidar_bits(block, 16u, 16u), 16u);
      to->has_temperature_c = raw >= -32767LL && raw <= 32767LL;
      to->temperature_c = (lidar_real)raw / (lidar_real)100.0; }
    { const uint64_t raw = lidar_bits(block, 32u, 16u);
      to->has_laser_power_w = raw <= 65534ULL;
      to->laser_power_w = (lidar_real)raw / (lidar_real)1000.0; }
}

#define LIDAR_CAN_AGE_BYTES 8u

typedef struct {
    uint64_t uptime_s; /* s */
    bool has_uptime_s;
    lidar_real truth_age_s; /* s */
    bool has_truth_age_s;
} lidar_can_age;

static inline void lidar_unpack_can_age(const uint8_t *block, lidar_can_age *to) {
    { const uint64_t raw = lidar_bits(block, 0u, 32u);
      to->has_uptime_s = raw <= 4294967294ULL;
      to->uptime_s = raw; }
    { const uint64_t raw = lidar_bits(block, 32u, 32u);
      to->has_truth_age_s = raw <= 4294967294ULL;
      to->truth_age_s = (lidar_real)raw / (lidar_real)1000000.0; }
}

#define LIDAR_CAN_SHOTS_LOST_BYTES 8u

typedef struct {
    uint64_t shots_dropped;
    uint64_t shots_late;
} lidar_can_shots_lost;

static inline void lidar_unpack_can_shots_lost(const uint8_t *block, lidar_can_shots_lost *to) {
    to->shots_dropped = lidar_bits(block, 0u, 32u);
    to->shots_late = lidar_bits(block, 32u, 32u);
}

#define LIDAR_CAN_COMMANDS_LOST_BYTES 8u

typedef struct {
    uint64_t commands_accepted;
    uint64_t commands_rejected;
    uint64_t bad_bytes;
} lidar_can_commands_lost;

static inline void lidar_unpack_can_commands_lost(const uint8_t *block, lidar_can_commands_lost *to) {
    to->commands_accepted = lidar_bits(block, 0u, 16u);
    to->commands_rejected = lidar_bits(block, 16u, 16u);
    to->bad_bytes = lidar_bits(block, 32u, 32u);
}

#define LIDAR_CAN_VERSIONS_BYTES 4u

typedef struct {
    uint64_t interface_version;
    uint64_t software_major;
    uint64_t software_minor;
    uint64_t software_patch;
} lidar_can_versions;

static inline void lidar_unpack_can_versions(const uint8_t *block, lidar_can_versions *to) {
    { const uint64_t raw = lidar_bits(block, 0u, 8u);
      to->interface_version = raw; }
    { const uint64_t raw = lidar_bits(block, 8u, 8u);
      to->software_major = raw; }
    { const uint64_t raw = lidar_bits(block, 16u, 8u);
      to->software_minor = raw; }
    { const uint64_t raw = lidar_bits(block, 24u, 8u);
      to->software_patch = raw; }
}

/* crc16_ccitt_false; 0x29B1 for "123456789". Start with LIDAR_CRC_START. */
#define LIDAR_CRC_START 0xFFFFu
static inline uint16_t lidar_crc(uint16_t crc, const uint8_t *data, size_t length) {
    static const uint16_t table[256] = {
        0x0000u, 0x1021u, 0x2042u, 0x3063u, 0x4084u, 0x50A5u, 0x60C6u, 0x70E7u,
        0x8108u, 0x9129u, 0xA14Au, 0xB16Bu, 0xC18Cu, 0xD1ADu, 0xE1CEu, 0xF1EFu,
        0x1231u, 0x0210u, 0x3273u, 0x2252u, 0x52B5u, 0x4294u, 0x72F7u, 0x62D6u,
        0x9339u, 0x8318u, 0xB37Bu, 0xA35Au, 0xD3BDu, 0xC39Cu, 0xF3FFu, 0xE3DEu,
        0x2462u, 0x3443u, 0x0420u, 0x1401u, 0x64E6u, 0x74C7u, 0x44A4u, 0x5485u,
        0xA56Au, 0xB54Bu, 0x8528u, 0x9509u, 0xE5EEu, 0xF5CFu, 0xC5ACu, 0xD58Du,
        0x3653u, 0x2672u, 0x1611u, 0x0630u, 0x76D7u, 0x66F6u, 0x5695u, 0x46B4u,
        0xB75Bu, 0xA77Au, 0x9719u, 0x8738u, 0xF7DFu, 0xE7FEu, 0xD79Du, 0xC7BCu,
        0x48C4u, 0x58E5u, 0x6886u, 0x78A7u, 0x0840u, 0x1861u, 0x2802u, 0x3823u,
        0xC9CCu, 0xD9EDu, 0xE98Eu, 0xF9AFu, 0x8948u, 0x9969u, 0xA90Au, 0xB92Bu,
        0x5AF5u, 0x4AD4u, 0x7AB7u, 0x6A96u, 0x1A71u, 0x0A50u, 0x3A33u, 0x2A12u,
        0xDBFDu, 0xCBDCu, 0xFBBFu, 0xEB9Eu, 0x9B79u, 0x8B58u, 0xBB3Bu, 0xAB1Au,
        0x6CA6u, 0x7C87u, 0x4CE4u, 0x5CC5u, 0x2C22u, 0x3C03u, 0x0C60u, 0x1C41u,
        0xEDAEu, 0xFD8Fu, 0xCDECu, 0xDDCDu, 0xAD2Au, 0xBD0Bu, 0x8D68u, 0x9D49u,
        0x7E97u, 0x6EB6u, 0x5ED5u, 0x4EF4u, 0x3E13u, 0x2E32u, 0x1E51u, 0x0E70u,
        0xFF9Fu, 0xEFBEu, 0xDFDDu, 0xCFFCu, 0xBF1Bu, 0xAF3Au, 0x9F59u, 0x8F78u,
        0x9188u, 0x81A9u, 0xB1CAu, 0xA1EBu, 0xD10Cu, 0xC12Du, 0xF14Eu, 0xE16Fu,
        0x1080u, 0x00A1u, 0x30C2u, 0x20E3u, 0x5004u, 0x4025u, 0x7046u, 0x6067u,
        0x83B9u, 0x9398u, 0xA3FBu, 0xB3DAu, 0xC33Du, 0xD31Cu, 0xE37Fu, 0xF35Eu,
        0x02B1u, 0x1290u, 0x22F3u, 0x32D2u, 0x4235u, 0x5214u, 0x6277u, 0x7256u,
        0xB5EAu, 0xA5CBu, 0x95A8u, 0x8589u, 0xF56Eu, 0xE54Fu, 0xD52Cu, 0xC50Du,
        0x34E2u, 0x24C3u, 0x14A0u, 0x0481u, 0x7466u, 0x6447u, 0x5424u, 0x4405u,
        0xA7DBu, 0xB7FAu, 0x8799u, 0x97B8u, 0xE75Fu, 0xF77Eu, 0xC71Du, 0xD73Cu,
        0x26D3u, 0x36F2u, 0x0691u, 0x16B0u, 0x6657u, 0x7676u, 0x4615u, 0x5634u,
        0xD94Cu, 0xC96Du, 0xF90Eu, 0xE92Fu, 0x99C8u, 0x89E9u, 0xB98Au, 0xA9ABu,
        0x5844u, 0x4865u, 0x7806u, 0x6827u, 0x18C0u, 0x08E1u, 0x3882u, 0x28A3u,
        0xCB7Du, 0xDB5Cu, 0xEB3Fu, 0xFB1Eu, 0x8BF9u, 0x9BD8u, 0xABBBu, 0xBB9Au,
        0x4A75u, 0x5A54u, 0x6A37u, 0x7A16u, 0x0AF1u, 0x1AD0u, 0x2AB3u, 0x3A92u,
        0xFD2Eu, 0xED0Fu, 0xDD6Cu, 0xCD4Du, 0xBDAAu, 0xAD8Bu, 0x9DE8u, 0x8DC9u,
        0x7C26u, 0x6C07u, 0x5C64u, 0x4C45u, 0x3CA2u, 0x2C83u, 0x1CE0u, 0x0CC1u,
        0xEF1Fu, 0xFF3Eu, 0xCF5Du, 0xDF7Cu, 0xAF9Bu, 0xBFBAu, 0x8FD9u, 0x9FF8u,
        0x6E17u, 0x7E36u, 0x4E55u, 0x5E74u, 0x2E93u, 0x3EB2u, 0x0ED1u, 0x1EF0u
    };
    crc ^= 0x0u;
    for (size_t k = 0u; k < length; k++)
        crc = (uint16_t)((uint16_t)(crc << 8) ^ table[(crc >> 8 ^ data[k]) & 0xFFu]);
    return crc ^ 0x0u;
}

/* The kind of a valid packet of this interface, whose unit is set; otherwise LIDAR_NOTHING. */
static inline lidar_kind lidar_check(const uint8_t *packet, size_t length, unsigned *unit) {
    if (length <= LIDAR_HEADER_BYTES + LIDAR_CRC_BYTES)
        return LIDAR_NOTHING;
    uint16_t crc = LIDAR_CRC_START;
    uint32_t stated = 0u;
    crc = lidar_crc(crc, packet + 0u, length - LIDAR_CRC_BYTES - 0u);
    for (size_t k = 0u; k < LIDAR_CRC_BYTES; k++)
        stated = stated << 8 | packet[length - LIDAR_CRC_BYTES + k];
    if (stated != crc)
        return LIDAR_NOTHING;
    const unsigned identification = (unsigned)packet[0] << 8 | packet[1];
    if (((size_t)packet[4] << 8 | packet[5]) + 7u != length || packet[2] < 0xC0u)
        return LIDAR_NOTHING;
    if (identification >= 0xAA0u && identification < 0xAA0u + LIDAR_UNITS) {
        *unit = identification - 0xAA0u;
        return LIDAR_MEASUREMENT;
    }
    if (identification >= 0xAC0u && identification < 0xAC0u + LIDAR_UNITS) {
        *unit = identification - 0xAC0u;
        return LIDAR_ACKNOWLEDGE;
    }
    if (identification >= 0xAB0u && identification < 0xAB0u + LIDAR_UNITS) {
        *unit = identification - 0xAB0u;
        return LIDAR_HOUSEKEEPING;
    }
    return LIDAR_NOTHING;
}

typedef struct {
    lidar_shot shot;
    size_t beam_count;
    lidar_beam beams[LIDAR_MAXIMUM_BEAMS];
} lidar_measurement;

static inline bool lidar_read_measurement(
    const uint8_t *packet, size_t length, unsigned *unit, lidar_measurement *to) {
    if (lidar_check(packet, length, unit) != LIDAR_MEASUREMENT || length < LIDAR_HEADER_BYTES + LIDAR_SHOT_BYTES + LIDAR_CRC_BYTES)
        return false;
    lidar_unpack_shot(packet + LIDAR_HEADER_BYTES, &to->shot);
    to->beam_count = (length - (LIDAR_HEADER_BYTES + LIDAR_SHOT_BYTES + LIDAR_CRC_BYTES)) / LIDAR_BEAM_BYTES;
    if (length != LIDAR_HEADER_BYTES + LIDAR_SHOT_BYTES + LIDAR_CRC_BYTES + to->beam_count * LIDAR_BEAM_BYTES ||
        to->beam_count == 0u || to->beam_count > LIDAR_MAXIMUM_BEAMS || to->shot.beam_count != to->beam_count)
        return false;
    for (size_t k = 0u; k < to->beam_count; k++)
        lidar_unpack_beam(packet + LIDAR_HEADER_BYTES + LIDAR_SHOT_BYTES + k * LIDAR_BEAM_BYTES, &to->beams[k]);
    return to->shot.interface_version == LIDAR_INTERFACE_VERSION;
}

static inline bool lidar_read_acknowledge(
    const uint8_t *packet, size_t length, unsigned *unit, lidar_acknowledge *to) {
    if (lidar_check(packet, length, unit) != LIDAR_ACKNOWLEDGE ||
        length != LIDAR_HEADER_BYTES + LIDAR_ACKNOWLEDGE_BYTES + LIDAR_CRC_BYTES)
        return false;
    lidar_unpack_acknowledge(packet + LIDAR_HEADER_BYTES, to);
    return true;
}

static inline bool lidar_read_housekeeping(
    const uint8_t *packet, size_t length, unsigned *unit, lidar_housekeeping *to) {
    if (lidar_check(packet, length, unit) != LIDAR_HOUSEKEEPING ||
        length != LIDAR_HEADER_BYTES + LIDAR_HOUSEKEEPING_BYTES + LIDAR_CRC_BYTES)
        return false;
    lidar_unpack_housekeeping(packet + LIDAR_HEADER_BYTES, to);
    return to->interface_version == LIDAR_INTERFACE_VERSION;
}

#define LIDAR_DELIMITER 0x00u

/* Decode a frame in place; returns the length of its content, 0 if it ends inside a run or has a zero byte. */
static inline size_t lidar_unstuff(uint8_t *data, size_t length) {
    size_t position = 0u, written = 0u;
    while (position < length) {
        const size_t code = data[position];
        if (code == 0u || position + code > length)
            return 0u;
        lidar_move(data + written, data + position + 1u, code - 1u);
        written += code - 1u;
        position += code;
        if (code < 255u && position < length)
            data[written++] = 0u;
    }
    return written;
}

/* Frame a packet, with a delimiter before it too; returns the number of bytes. */
static inline size_t lidar_frame(uint8_t *to, const uint8_t *packet, size_t length) {
    size_t code = 1u, end = 2u; /* positions of the code byte of this run and of the next byte */
    to[0] = 0u;
    for (size_t k = 0u; k < length; k++) {
        if (packet[k] != 0u)
            to[end++] = packet[k];
        if (packet[k] == 0u || (end - code == 255u && k + 1u < length)) {
            to[code] = (uint8_t)(end - code);
            code = end++;
        }
    }
    to[code] = (uint8_t)(end - code);
    to[end++] = 0u;
    return end;
}

typedef struct {
    uint8_t data[LIDAR_LONGEST_FRAME];
    size_t length;
    bool is_complete, is_too_long;
    const uint8_t *packet;
    size_t packet_length;
    uint32_t bad_frames; /* frames without a valid packet */
} lidar_receiver;

/* Add a received byte. The packet that lidar_next() found before is no longer valid. */
static inline void lidar_feed(lidar_receiver *receiver, uint8_t byte) {
    if (receiver->is_complete) {
        receiver->is_complete = receiver->is_too_long = false;
        receiver->length = 0u;
    }
    if (byte == LIDAR_DELIMITER)
        receiver->is_complete = true;
    else if (receiver->length < sizeof receiver->data)
        receiver->data[receiver->length++] = byte;
    else
        receiver->is_too_long = true;
}

/* Find a valid packet: sets `packet` and `packet_length`, or returns false. */
static inline bool lidar_next(lidar_receiver *receiver) {
    const size_t length = receiver->length;
    unsigned unit;
    if (!receiver->is_complete || (length == 0u && !receiver->is_too_long))
        return false;
    receiver->packet = receiver->data;
    receiver->packet_length = receiver->is_too_long ? 0u : lidar_unstuff(receiver->data, length);
    receiver->length = 0u;
    receiver->is_too_long = false;
    if (lidar_check(receiver->packet, receiver->packet_length, &unit) != LIDAR_NOTHING)
        return true;
    receiver->bad_frames++;
    return false;
}

#define LIDAR_LONGEST_COMMAND 20u

static inline void lidar_put(uint8_t *block, size_t first_bit, unsigned bits, uint64_t word) {
    for (size_t k = 0u; k < bits; k++) {
        const size_t bit = first_bit + bits - 1u - k;
        block[bit / 8u] = (uint8_t)(block[bit / 8u] | (word >> k & 1u) << (7u - bit % 8u));
    }
}

static inline bool lidar_put_bits(uint8_t *block, size_t first_bit, unsigned bits, uint64_t word) {
    lidar_put(block, first_bit, bits, word);
    return true;
}

static inline bool lidar_put_unsigned(
    uint8_t *block, size_t first_bit, unsigned bits, uint64_t value, uint64_t lowest, uint64_t highest) {
    lidar_put(block, first_bit, bits, value);
    return value >= lowest && value <= highest;
}

static inline bool lidar_put_signed(
    uint8_t *block, size_t first_bit, unsigned bits, int64_t value, int64_t lowest, int64_t highest, int64_t offset) {
    lidar_put(block, first_bit, bits, (uint64_t)value - (uint64_t)offset);
    return value >= lowest && value <= highest;
}

/* Put a number of steps, rounded to the nearest integer; NaN is out of any range. */
static inline bool lidar_put_steps(
    uint8_t *block, size_t first_bit, unsigned bits, lidar_real steps, double lowest, double end) {
    const lidar_real raised = steps + (lidar_real)0.5;
    int64_t below;
    if (!((double)raised >= lowest && (double)raised < end))
        return false;
    below = raised < (lidar_real)0.0 ? (int64_t)raised : 0;
    if ((lidar_real)below > raised)
        below--;
    lidar_put(block, first_bit, bits, below < 0 ? (uint64_t)below : (uint64_t)raised);
    return true;
}

/* Put nanoseconds as a time code of 4 + 3 bytes. */
static inline bool lidar_put_time(uint8_t *block, size_t first_bit, int64_t time_ns) {
    const uint64_t seconds = (uint64_t)time_ns / 1000000000u, rest = (uint64_t)time_ns % 1000000000u;
    const uint64_t ticks = (seconds << 24) + ((rest << 24) + 500000000u) / 1000000000u;
    lidar_put(block, first_bit, 56u, ticks);
    return time_ns >= 0 && ticks < (uint64_t)1 << 56;
}

static inline bool lidar_put_float(
    uint8_t *block, size_t first_bit, unsigned bits, lidar_real value, double lowest, double highest) {
    const bool in_range = (double)value >= lowest && (double)value <= highest;
    const float number = in_range ? (float)value : 0.0f;
    uint32_t word;
    lidar_move(&word, &number, sizeof word);
    lidar_put(block, first_bit, bits, word);
    return in_range;
}

static inline bool lidar_put_double(
    uint8_t *block, size_t first_bit, unsigned bits, double value, double lowest, double highest) {
    uint64_t word;
    lidar_move(&word, &value, sizeof word);
    lidar_put(block, first_bit, bits, word);
    return value >= lowest && value <= highest;
}

/* Complete the packet of a command around its body, and frame it; returns the number of bytes. */
static inline size_t lidar_seal(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint8_t *packet, size_t length) {
    const uint64_t words[3] = {0x12A0u + to_unit, 0xC000u | (sequence & 0x3FFFu), length - 7u};
    for (size_t k = 0u; k < 3u; k++) {
        packet[2u * k] = (uint8_t)(words[k] >> 8);
        packet[2u * k + 1u] = (uint8_t)words[k];
    }
    uint16_t crc = LIDAR_CRC_START;
    crc = lidar_crc(crc, packet + 0u, length - LIDAR_CRC_BYTES - 0u);
    packet[length - 2u] = (uint8_t)(crc >> 8);
    packet[length - 1u] = (uint8_t)(crc >> 0);
    return lidar_frame(to, packet, length);
}

#define LIDAR_COMMAND_NO_OP_BYTES 2u

static inline bool lidar_pack_no_op(uint8_t *block, uint64_t sequence) {
    lidar_clear(block, LIDAR_COMMAND_NO_OP_BYTES);
    lidar_put(block, 0u, 8u, 0u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL);
}

static inline size_t lidar_encode_no_op(
    uint8_t *to, unsigned to_unit, uint64_t sequence) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_NO_OP_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_no_op(packet + LIDAR_HEADER_BYTES, sequence))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_NO_OP 0x130u
#define LIDAR_CAN_COMMAND_NO_OP_BYTES 1u

static inline bool lidar_pack_can_no_op(uint8_t *block, uint64_t sequence) {
    lidar_clear(block, LIDAR_CAN_COMMAND_NO_OP_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL);
}

#define LIDAR_COMMAND_SET_MODE_BYTES 3u

static inline bool lidar_pack_set_mode(uint8_t *block, uint64_t sequence, uint64_t mode) {
    lidar_clear(block, LIDAR_COMMAND_SET_MODE_BYTES);
    lidar_put(block, 0u, 8u, 1u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 16u, 8u, mode, 0ULL, 255ULL);
}

static inline size_t lidar_encode_set_mode(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint64_t mode) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_SET_MODE_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_set_mode(packet + LIDAR_HEADER_BYTES, sequence, mode))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_SET_MODE 0x131u
#define LIDAR_CAN_COMMAND_SET_MODE_BYTES 2u

static inline bool lidar_pack_can_set_mode(uint8_t *block, uint64_t sequence, uint64_t mode) {
    lidar_clear(block, LIDAR_CAN_COMMAND_SET_MODE_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 8u, 8u, mode, 0ULL, 255ULL);
}

#define LIDAR_COMMAND_SET_PATTERN_BYTES 3u

static inline bool lidar_pack_set_pattern(uint8_t *block, uint64_t sequence, uint64_t pattern) {
    lidar_clear(block, LIDAR_COMMAND_SET_PATTERN_BYTES);
    lidar_put(block, 0u, 8u, 2u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 16u, 8u, pattern, 0ULL, 255ULL);
}

static inline size_t lidar_encode_set_pattern(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint64_t pattern) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_SET_PATTERN_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_set_pattern(packet + LIDAR_HEADER_BYTES, sequence, pattern))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_SET_PATTERN 0x132u
#define LIDAR_CAN_COMMAND_SET_PATTERN_BYTES 2u

static inline bool lidar_pack_can_set_pattern(uint8_t *block, uint64_t sequence, uint64_t pattern) {
    lidar_clear(block, LIDAR_CAN_COMMAND_SET_PATTERN_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 8u, 8u, pattern, 0ULL, 255ULL);
}

#define LIDAR_COMMAND_SET_RATE_HZ_BYTES 6u

static inline bool lidar_pack_set_rate_hz(uint8_t *block, uint64_t sequence, lidar_real rate_hz) {
    lidar_clear(block, LIDAR_COMMAND_SET_RATE_HZ_BYTES);
    lidar_put(block, 0u, 8u, 3u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_steps(block, 16u, 32u, rate_hz * (lidar_real)1000.0, 1.0, 10000001.0);
}

static inline size_t lidar_encode_set_rate_hz(
    uint8_t *to, unsigned to_unit, uint64_t sequence, lidar_real rate_hz) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_SET_RATE_HZ_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_set_rate_hz(packet + LIDAR_HEADER_BYTES, sequence, rate_hz))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_SET_RATE_HZ 0x133u
#define LIDAR_CAN_COMMAND_SET_RATE_HZ_BYTES 5u

static inline bool lidar_pack_can_set_rate_hz(uint8_t *block, uint64_t sequence, lidar_real rate_hz) {
    lidar_clear(block, LIDAR_CAN_COMMAND_SET_RATE_HZ_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_steps(block, 8u, 32u, rate_hz * (lidar_real)1000.0, 1.0, 10000001.0);
}

#define LIDAR_COMMAND_ENABLE_BEAMS_BYTES 6u

static inline bool lidar_pack_enable_beams(uint8_t *block, uint64_t sequence, uint64_t beams) {
    lidar_clear(block, LIDAR_COMMAND_ENABLE_BEAMS_BYTES);
    lidar_put(block, 0u, 8u, 4u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 16u, 32u, beams, 0ULL, 4294967295ULL);
}

static inline size_t lidar_encode_enable_beams(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint64_t beams) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_ENABLE_BEAMS_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_enable_beams(packet + LIDAR_HEADER_BYTES, sequence, beams))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_ENABLE_BEAMS 0x134u
#define LIDAR_CAN_COMMAND_ENABLE_BEAMS_BYTES 5u

static inline bool lidar_pack_can_enable_beams(uint8_t *block, uint64_t sequence, uint64_t beams) {
    lidar_clear(block, LIDAR_CAN_COMMAND_ENABLE_BEAMS_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 8u, 32u, beams, 0ULL, 4294967295ULL);
}

#define LIDAR_COMMAND_TIME_AT_TONE_BYTES 9u

static inline bool lidar_pack_time_at_tone(uint8_t *block, uint64_t sequence, int64_t tone_ns) {
    lidar_clear(block, LIDAR_COMMAND_TIME_AT_TONE_BYTES);
    lidar_put(block, 0u, 8u, 5u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_time(block, 16u, tone_ns);
}

static inline size_t lidar_encode_time_at_tone(
    uint8_t *to, unsigned to_unit, uint64_t sequence, int64_t tone_ns) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_TIME_AT_TONE_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_time_at_tone(packet + LIDAR_HEADER_BYTES, sequence, tone_ns))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_TIME_AT_TONE 0x135u
#define LIDAR_CAN_COMMAND_TIME_AT_TONE_BYTES 8u

static inline bool lidar_pack_can_time_at_tone(uint8_t *block, uint64_t sequence, int64_t tone_ns) {
    lidar_clear(block, LIDAR_CAN_COMMAND_TIME_AT_TONE_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_time(block, 8u, tone_ns);
}

#define LIDAR_COMMAND_SET_PARAMETER_BYTES 8u

static inline bool lidar_pack_set_parameter(uint8_t *block, uint64_t sequence, uint64_t parameter, lidar_real number) {
    lidar_clear(block, LIDAR_COMMAND_SET_PARAMETER_BYTES);
    lidar_put(block, 0u, 8u, 6u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 16u, 16u, parameter, 0ULL, 65535ULL) &&
        lidar_put_float(block, 32u, 32u, number, -3.4028234663852886e+38, 3.4028234663852886e+38);
}

static inline size_t lidar_encode_set_parameter(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint64_t parameter, lidar_real number) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_SET_PARAMETER_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_set_parameter(packet + LIDAR_HEADER_BYTES, sequence, parameter, number))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_SET_PARAMETER 0x136u
#define LIDAR_CAN_COMMAND_SET_PARAMETER_BYTES 7u

static inline bool lidar_pack_can_set_parameter(uint8_t *block, uint64_t sequence, uint64_t parameter, lidar_real number) {
    lidar_clear(block, LIDAR_CAN_COMMAND_SET_PARAMETER_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 8u, 16u, parameter, 0ULL, 65535ULL) &&
        lidar_put_float(block, 24u, 32u, number, -3.4028234663852886e+38, 3.4028234663852886e+38);
}

#define LIDAR_COMMAND_RESET_BYTES 3u

static inline bool lidar_pack_reset(uint8_t *block, uint64_t sequence, uint64_t restart) {
    lidar_clear(block, LIDAR_COMMAND_RESET_BYTES);
    lidar_put(block, 0u, 8u, 7u);
    return lidar_put_unsigned(block, 8u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 16u, 8u, restart, 0ULL, 255ULL);
}

static inline size_t lidar_encode_reset(
    uint8_t *to, unsigned to_unit, uint64_t sequence, uint64_t restart) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_COMMAND_RESET_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_reset(packet + LIDAR_HEADER_BYTES, sequence, restart))
        return 0u;
    return lidar_seal(to, to_unit, (uint64_t)sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_RESET 0x137u
#define LIDAR_CAN_COMMAND_RESET_BYTES 2u

static inline bool lidar_pack_can_reset(uint8_t *block, uint64_t sequence, uint64_t restart) {
    lidar_clear(block, LIDAR_CAN_COMMAND_RESET_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 8u, 8u, restart, 0ULL, 255ULL);
}

#define LIDAR_LONGEST_MESSAGE 78u

#define LIDAR_MESSAGE_NAVIGATION_BYTES 67u

typedef struct {
    uint64_t command;
    uint64_t sequence;
    int64_t time_ns;
    uint64_t mode;
    lidar_real altitude_m; /* m */
    bool has_altitude_m;
    lidar_real position_east_m; /* m */
    bool has_position_east_m;
    lidar_real position_north_m; /* m */
    bool has_position_north_m;
    lidar_real position_up_m; /* m */
    bool has_position_up_m;
    lidar_real velocity_east_mps; /* m/s */
    bool has_velocity_east_mps;
    lidar_real velocity_north_mps; /* m/s */
    bool has_velocity_north_mps;
    lidar_real velocity_up_mps; /* m/s */
    bool has_velocity_up_mps;
    lidar_real sigma_altitude_m; /* m */
    bool has_sigma_altitude_m;
    lidar_real sigma_position_east_m; /* m */
    bool has_sigma_position_east_m;
    lidar_real sigma_position_north_m; /* m */
    bool has_sigma_position_north_m;
    lidar_real sigma_position_up_m; /* m */
    bool has_sigma_position_up_m;
    lidar_real sigma_velocity_east_mps; /* m/s */
    bool has_sigma_velocity_east_mps;
    lidar_real sigma_velocity_north_mps; /* m/s */
    bool has_sigma_velocity_north_mps;
    lidar_real sigma_velocity_up_mps; /* m/s */
    bool has_sigma_velocity_up_mps;
    uint64_t range_trust_0;
    uint64_t speed_trust_0;
    uint64_t range_trust_1;
    uint64_t speed_trust_1;
    uint64_t range_trust_2;
    uint64_t speed_trust_2;
    uint64_t range_trust_3;
    uint64_t speed_trust_3;
    uint64_t range_trust_4;
    uint64_t speed_trust_4;
    uint64_t range_trust_5;
    uint64_t speed_trust_5;
    uint64_t range_trust_6;
    uint64_t speed_trust_6;
    uint64_t range_trust_7;
    uint64_t speed_trust_7;
} lidar_message_navigation;

static inline void lidar_unpack_message_navigation(const uint8_t *block, lidar_message_navigation *to) {
    { const uint64_t raw = lidar_bits(block, 0u, 8u);
      to->command = raw; }
    { const uint64_t raw = lidar_bits(block, 8u, 8u);
      to->sequence = raw; }
    to->time_ns = lidar_nanoseconds(lidar_bits(block, 16u, 56u));
    { const uint64_t raw = lidar_bits(block, 72u, 8u);
      to->mode = raw; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 80u, 32u), 32u);
      to->has_altitude_m = raw >= -2147483647LL && raw <= 2147483647LL;
      to->altitude_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 112u, 32u), 32u);
      to->has_position_east_m = raw >= -2147483647LL && raw <= 2147483647LL;
      to->position_east_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 144u, 32u), 32u);
      to->has_position_north_m = raw >= -2147483647LL && raw <= 2147483647LL;
      to->position_north_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 176u, 32u), 32u);
      to->has_position_up_m = raw >= -2147483647LL && raw <= 2147483647LL;
      to->position_up_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 208u, 32u), 32u);
      to->has_velocity_east_mps = raw >= -2147483647LL && raw <= 2147483647LL;
      to->velocity_east_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 240u, 32u), 32u);
      to->has_velocity_north_mps = raw >= -2147483647LL && raw <= 2147483647LL;
      to->velocity_north_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const int64_t raw = lidar_signed(lidar_bits(block, 272u, 32u), 32u);
      to->has_velocity_up_mps = raw >= -2147483647LL && raw <= 2147483647LL;
      to->velocity_up_mps = (lidar_real)raw / (lidar_real)10000.0; }
    { const uint64_t raw = lidar_bits(block, 304u, 24u);
      to->has_sigma_altitude_m = raw <= 16777214ULL;
      to->sigma_altitude_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 328u, 24u);
      to->has_sigma_position_east_m = raw <= 16777214ULL;
      to->sigma_position_east_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 352u, 24u);
      to->has_sigma_position_north_m = raw <= 16777214ULL;
      to->sigma_position_north_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 376u, 24u);
      to->has_sigma_position_up_m = raw <= 16777214ULL;
      to->sigma_position_up_m = (lidar_real)raw / (lidar_real)1000.0; }
    { const uint64_t raw = lidar_bits(block, 400u, 24u);
      to->has_sigma_velocity_east_mps = raw <= 16777214ULL;
      to->sigma_velocity_east_mps = (lidar_real)raw / (lidar_real)100000.0; }
    { const uint64_t raw = lidar_bits(block, 424u, 24u);
      to->has_sigma_velocity_north_mps = raw <= 16777214ULL;
      to->sigma_velocity_north_mps = (lidar_real)raw / (lidar_real)100000.0; }
    { const uint64_t raw = lidar_bits(block, 448u, 24u);
      to->has_sigma_velocity_up_mps = raw <= 16777214ULL;
      to->sigma_velocity_up_mps = (lidar_real)raw / (lidar_real)100000.0; }
    { const uint64_t raw = lidar_bits(block, 472u, 4u);
      to->range_trust_0 = raw; }
    { const uint64_t raw = lidar_bits(block, 476u, 4u);
      to->speed_trust_0 = raw; }
    { const uint64_t raw = lidar_bits(block, 480u, 4u);
      to->range_trust_1 = raw; }
    { const uint64_t raw = lidar_bits(block, 484u, 4u);
      to->speed_trust_1 = raw; }
    { const uint64_t raw = lidar_bits(block, 488u, 4u);
      to->range_trust_2 = raw; }
    { const uint64_t raw = lidar_bits(block, 492u, 4u);
      to->speed_trust_2 = raw; }
    { const uint64_t raw = lidar_bits(block, 496u, 4u);
      to->range_trust_3 = raw; }
    { const uint64_t raw = lidar_bits(block, 500u, 4u);
      to->speed_trust_3 = raw; }
    { const uint64_t raw = lidar_bits(block, 504u, 4u);
      to->range_trust_4 = raw; }
    { const uint64_t raw = lidar_bits(block, 508u, 4u);
      to->speed_trust_4 = raw; }
    { const uint64_t raw = lidar_bits(block, 512u, 4u);
      to->range_trust_5 = raw; }
    { const uint64_t raw = lidar_bits(block, 516u, 4u);
      to->speed_trust_5 = raw; }
    { const uint64_t raw = lidar_bits(block, 520u, 4u);
      to->range_trust_6 = raw; }
    { const uint64_t raw = lidar_bits(block, 524u, 4u);
      to->speed_trust_6 = raw; }
    { const uint64_t raw = lidar_bits(block, 528u, 4u);
      to->range_trust_7 = raw; }
    { const uint64_t raw = lidar_bits(block, 532u, 4u);
      to->speed_trust_7 = raw; }
}

static inline bool lidar_pack_message_navigation(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_MESSAGE_NAVIGATION_BYTES);
    lidar_put(block, 0u, 8u, 16u);
    return lidar_put_unsigned(block, 8u, 8u, from->sequence, 0ULL, 255ULL) &&
        lidar_put_time(block, 16u, from->time_ns) &&
        lidar_put_unsigned(block, 72u, 8u, from->mode, 0ULL, 255ULL) &&
        (from->has_altitude_m ? lidar_put_steps(block, 80u, 32u, from->altitude_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 80u, 32u, 0x80000000u)) &&
        (from->has_position_east_m ? lidar_put_steps(block, 112u, 32u, from->position_east_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 112u, 32u, 0x80000000u)) &&
        (from->has_position_north_m ? lidar_put_steps(block, 144u, 32u, from->position_north_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 144u, 32u, 0x80000000u)) &&
        (from->has_position_up_m ? lidar_put_steps(block, 176u, 32u, from->position_up_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 176u, 32u, 0x80000000u)) &&
        (from->has_velocity_east_mps ? lidar_put_steps(block, 208u, 32u, from->velocity_east_mps * (lidar_real)10000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 208u, 32u, 0x80000000u)) &&
        (from->has_velocity_north_mps ? lidar_put_steps(block, 240u, 32u, from->velocity_north_mps * (lidar_real)10000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 240u, 32u, 0x80000000u)) &&
        (from->has_velocity_up_mps ? lidar_put_steps(block, 272u, 32u, from->velocity_up_mps * (lidar_real)10000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 272u, 32u, 0x80000000u)) &&
        (from->has_sigma_altitude_m ? lidar_put_steps(block, 304u, 24u, from->sigma_altitude_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 304u, 24u, 0xFFFFFFu)) &&
        (from->has_sigma_position_east_m ? lidar_put_steps(block, 328u, 24u, from->sigma_position_east_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 328u, 24u, 0xFFFFFFu)) &&
        (from->has_sigma_position_north_m ? lidar_put_steps(block, 352u, 24u, from->sigma_position_north_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 352u, 24u, 0xFFFFFFu)) &&
        (from->has_sigma_position_up_m ? lidar_put_steps(block, 376u, 24u, from->sigma_position_up_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 376u, 24u, 0xFFFFFFu)) &&
        (from->has_sigma_velocity_east_mps ? lidar_put_steps(block, 400u, 24u, from->sigma_velocity_east_mps * (lidar_real)100000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 400u, 24u, 0xFFFFFFu)) &&
        (from->has_sigma_velocity_north_mps ? lidar_put_steps(block, 424u, 24u, from->sigma_velocity_north_mps * (lidar_real)100000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 424u, 24u, 0xFFFFFFu)) &&
        (from->has_sigma_velocity_up_mps ? lidar_put_steps(block, 448u, 24u, from->sigma_velocity_up_mps * (lidar_real)100000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 448u, 24u, 0xFFFFFFu)) &&
        lidar_put_unsigned(block, 472u, 4u, from->range_trust_0, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 476u, 4u, from->speed_trust_0, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 480u, 4u, from->range_trust_1, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 484u, 4u, from->speed_trust_1, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 488u, 4u, from->range_trust_2, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 492u, 4u, from->speed_trust_2, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 496u, 4u, from->range_trust_3, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 500u, 4u, from->speed_trust_3, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 504u, 4u, from->range_trust_4, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 508u, 4u, from->speed_trust_4, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 512u, 4u, from->range_trust_5, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 516u, 4u, from->speed_trust_5, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 520u, 4u, from->range_trust_6, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 524u, 4u, from->speed_trust_6, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 528u, 4u, from->range_trust_7, 0ULL, 15ULL) &&
        lidar_put_unsigned(block, 532u, 4u, from->speed_trust_7, 0ULL, 15ULL);
}

static inline size_t lidar_encode_navigation(uint8_t *to, unsigned to_unit, const lidar_message_navigation *from) {
    uint8_t packet[LIDAR_HEADER_BYTES + LIDAR_MESSAGE_NAVIGATION_BYTES + LIDAR_CRC_BYTES];
    if (to_unit >= LIDAR_UNITS || !lidar_pack_message_navigation(packet + LIDAR_HEADER_BYTES, from))
        return 0u;
    return lidar_seal(to, to_unit, from->sequence, packet, sizeof packet);
}

#define LIDAR_CAN_ID_NAVIGATION_TIME 0x121u
#define LIDAR_CAN_NAVIGATION_TIME_BYTES 8u

static inline bool lidar_pack_can_navigation_time(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_TIME_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        lidar_put_time(block, 8u, from->time_ns);
}

#define LIDAR_CAN_ID_NAVIGATION_ALTITUDE 0x122u
#define LIDAR_CAN_NAVIGATION_ALTITUDE_BYTES 8u

static inline bool lidar_pack_can_navigation_altitude(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_ALTITUDE_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_altitude_m ? lidar_put_steps(block, 8u, 32u, from->altitude_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_altitude_m ? lidar_put_steps(block, 40u, 24u, from->sigma_altitude_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_VELOCITY_EAST 0x123u
#define LIDAR_CAN_NAVIGATION_VELOCITY_EAST_BYTES 8u

static inline bool lidar_pack_can_navigation_velocity_east(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_VELOCITY_EAST_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_velocity_east_mps ? lidar_put_steps(block, 8u, 32u, from->velocity_east_mps * (lidar_real)10000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_velocity_east_mps ? lidar_put_steps(block, 40u, 24u, from->sigma_velocity_east_mps * (lidar_real)100000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_VELOCITY_NORTH 0x124u
#define LIDAR_CAN_NAVIGATION_VELOCITY_NORTH_BYTES 8u

static inline bool lidar_pack_can_navigation_velocity_north(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_VELOCITY_NORTH_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_velocity_north_mps ? lidar_put_steps(block, 8u, 32u, from->velocity_north_mps * (lidar_real)10000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_velocity_north_mps ? lidar_put_steps(block, 40u, 24u, from->sigma_velocity_north_mps * (lidar_real)100000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_VELOCITY_UP 0x125u
#define LIDAR_CAN_NAVIGATION_VELOCITY_UP_BYTES 8u

static inline bool lidar_pack_can_navigation_velocity_up(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_VELOCITY_UP_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_velocity_up_mps ? lidar_put_steps(block, 8u, 32u, from->velocity_up_mps * (lidar_real)10000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_velocity_up_mps ? lidar_put_steps(block, 40u, 24u, from->sigma_velocity_up_mps * (lidar_real)100000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_POSITION_EAST 0x126u
#define LIDAR_CAN_NAVIGATION_POSITION_EAST_BYTES 8u

static inline bool lidar_pack_can_navigation_position_east(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_POSITION_EAST_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_position_east_m ? lidar_put_steps(block, 8u, 32u, from->position_east_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_position_east_m ? lidar_put_steps(block, 40u, 24u, from->sigma_position_east_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_POSITION_NORTH 0x127u
#define LIDAR_CAN_NAVIGATION_POSITION_NORTH_BYTES 8u

static inline bool lidar_pack_can_navigation_position_north(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_POSITION_NORTH_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_position_north_m ? lidar_put_steps(block, 8u, 32u, from->position_north_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_position_north_m ? lidar_put_steps(block, 40u, 24u, from->sigma_position_north_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_POSITION_UP 0x13Eu
#define LIDAR_CAN_NAVIGATION_POSITION_UP_BYTES 8u

static inline bool lidar_pack_can_navigation_position_up(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_POSITION_UP_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        (from->has_position_up_m ? lidar_put_steps(block, 8u, 32u, from->position_up_m * (lidar_real)1000.0, -2147483647.0, 2147483648.0)
            : lidar_put_bits(block, 8u, 32u, 0x80000000u)) &&
        (from->has_sigma_position_up_m ? lidar_put_steps(block, 40u, 24u, from->sigma_position_up_m * (lidar_real)1000.0, 0.0, 16777215.0)
            : lidar_put_bits(block, 40u, 24u, 0xFFFFFFu));
}

#define LIDAR_CAN_ID_NAVIGATION_USE 0x13Fu
#define LIDAR_CAN_NAVIGATION_USE_BYTES 8u

static inline bool lidar_pack_can_navigation_use(uint8_t *block, const lidar_message_navigation *from) {
    lidar_clear(block, LIDAR_CAN_NAVIGATION_USE_BYTES);
    return lidar_put_unsigned(block, 0u, 8u, from->sequence, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 8u, 8u, from->mode, 0ULL, 255ULL) &&
        lidar_put_unsigned(block, 16u, 3u, from->range_trust_0, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 19u, 3u, from->speed_trust_0, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 22u, 3u, from->range_trust_1, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 25u, 3u, from->speed_trust_1, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 28u, 3u, from->range_trust_2, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 31u, 3u, from->speed_trust_2, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 34u, 3u, from->range_trust_3, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 37u, 3u, from->speed_trust_3, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 40u, 3u, from->range_trust_4, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 43u, 3u, from->speed_trust_4, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 46u, 3u, from->range_trust_5, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 49u, 3u, from->speed_trust_5, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 52u, 3u, from->range_trust_6, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 55u, 3u, from->speed_trust_6, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 58u, 3u, from->range_trust_7, 0ULL, 7ULL) &&
        lidar_put_unsigned(block, 61u, 3u, from->speed_trust_7, 0ULL, 7ULL);
}

#endif