/* The host side of a lidar for the component of a flight-software framework: bytes in, messages out, one command at a
 * time. It calls nothing of the framework; examples/fprime and examples/cfs wrap it.
 *
 *     lidar_host_feed(&host, byte);                                    (each received byte)
 *     while ((kind = lidar_host_next(&host)) != LIDAR_NOTHING) ...     (host.shot, host.health or host.answer is new)
 *
 *     length = lidar_encode_set_pattern(frame, UNIT, host.sequence, 1u);
 *     if (lidar_host_begin(&host, frame, length)) ...                  (send host.pending, host.pending_length)
 *     if (lidar_host_repeat(&host)) ...                                (each second: send it again)
 */
#ifndef LIDAR_HOST_H
#define LIDAR_HOST_H

#include "lidar.h"

enum { LIDAR_HOST_ATTEMPTS = 5 };

typedef struct {
    lidar_receiver receiver;
    lidar_measurement shot;
    lidar_housekeeping health;
    lidar_acknowledge answer;
    uint32_t shots, shots_lost, foreign_packets;
    uint32_t newest_shot; /* its number */
    uint8_t pending[LIDAR_LONGEST_COMMAND]; /* frame of the pending command */
    size_t pending_length;
    unsigned attempts; /* at the pending command; 0: none is pending */
    uint8_t sequence;  /* of the pending command, or of the next one */
    bool is_answered;  /* by the newest acknowledgement */
} lidar_host;

/* Count lost shots. An increment above half the range is a repeated shot or a restarted device. */
static inline void lidar_host_count_shot(lidar_host *host, uint32_t shot) {
    const uint32_t missing = shot - host->newest_shot - 1u;
    if (host->shots > 0u && missing < UINT32_MAX / 2u)
        host->shots_lost += missing;
    host->newest_shot = shot;
    host->shots++;
}

static inline void lidar_host_take_answer(lidar_host *host) {
    host->is_answered = host->attempts > 0u && host->answer.sequence == host->sequence;
    if (host->is_answered) {
        host->attempts = 0u;
        host->sequence++; /* 0 after 255 */
    }
}

static inline void lidar_host_feed(lidar_host *host, uint8_t byte) {
    lidar_feed(&host->receiver, byte);
}

/* Take the next message; return its kind, LIDAR_NOTHING if there is none yet. */
static inline lidar_kind lidar_host_next(lidar_host *host) {
    lidar_receiver *receiver = &host->receiver;
    while (lidar_next(receiver)) {
        unsigned unit;
        if (lidar_read_measurement(receiver->packet, receiver->packet_length, &unit, &host->shot)) {
            lidar_host_count_shot(host, (uint32_t)host->shot.shot.shot);
            return LIDAR_MEASUREMENT;
        }
        if (lidar_read_acknowledge(receiver->packet, receiver->packet_length, &unit, &host->answer)) {
            lidar_host_take_answer(host);
            return LIDAR_ACKNOWLEDGE;
        }
        if (lidar_read_housekeeping(receiver->packet, receiver->packet_length, &unit, &host->health))
            return LIDAR_HOUSEKEEPING;
        host->foreign_packets++; /* another version of the interface */
    }
    return LIDAR_NOTHING;
}

/* Make a framed command the pending one; false if its length is 0, or one is pending already. */
static inline bool lidar_host_begin(lidar_host *host, const uint8_t *frame, size_t length) {
    if (length == 0u || host->attempts > 0u)
        return false;
    lidar_move(host->pending, frame, length);
    host->pending_length = length;
    host->attempts = 1u;
    return true;
}

/* Whether to send the pending command again: command or acknowledgement may be lost. After LIDAR_HOST_ATTEMPTS the
 * command is given up: it is no longer pending, and its number is used for the next one. */
static inline bool lidar_host_repeat(lidar_host *host) {
    if (host->attempts == 0u)
        return false;
    if (host->attempts >= (unsigned)LIDAR_HOST_ATTEMPTS) {
        host->attempts = 0u;
        return false;
    }
    host->attempts++;
    return true;
}

#endif
