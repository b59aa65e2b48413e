/* The host side of a lidar for the component of a flight-software framework: bytes in, messages out, one command at a
 * time. It calls nothing of the framework; examples/fprime and examples/cfs wrap it.
 *
 *     lidar_host_feed(&host, byte);                                    (each received byte)
 *     while ((kind = lidar_host_next(&host)) != LIDAR_NOTHING) ...     (host.shot, host.health or host.answer is new)
 *
 *     length = lidar_encode_set_pattern(frame, host.unit, host.sequence, 1u);
 *     if (lidar_host_begin(&host, LIDAR_COMMAND_SET_PATTERN, frame, length)) ...
 *                                                                      (send host.pending, host.pending_length)
 *     if (lidar_host_repeat(&host)) ...                                (each second: send it again)
 */
#ifndef LIDAR_HOST_H
#define LIDAR_HOST_H

#include "lidar.h"

enum { LIDAR_HOST_ATTEMPTS = 5 };

typedef struct {
    unsigned unit; /* of the lidar; packets of other units on the line are skipped */
    lidar_receiver receiver;
    lidar_measurement shot;
    lidar_housekeeping health;
    lidar_acknowledge answer;
    uint32_t shots, shots_lost, foreign_packets;
    uint32_t newest_shot; /* its number */
    uint8_t pending[LIDAR_LONGEST_COMMAND]; /* frame of the pending command */
    size_t pending_length;
    uint8_t command;      /* code of the pending command */
    unsigned attempts;    /* at the pending command; 0: none is pending */
    uint8_t sequence;     /* of the pending command, or of the next one */
    bool is_answered;     /* by the newest acknowledgement */
    bool is_verdict_lost; /* is_answered, but whether the lidar followed the command is unknown */
} lidar_host;

/* Count lost shots. An increment above half the range is a repeated shot or a restarted device. */
static inline void lidar_host_count_shot(lidar_host *host, uint32_t shot) {
    const uint32_t missing = shot - host->newest_shot - 1u;
    if (host->shots > 0u && missing < UINT32_MAX / 2u)
        host->shots_lost += missing;
    host->newest_shot = shot;
    host->shots++;
}

/* A repeat is out of turn if the lidar has received an earlier attempt, whose verdict is then lost. The same answer
 * comes if no earlier attempt was received and the lidar counts from another number. The number of a command that was
 * given up is used again: the command code alone distinguishes a late answer to it from one to the pending command. */
static inline void lidar_host_take_answer(lidar_host *host) {
    const lidar_acknowledge *answer = &host->answer;
    host->is_answered =
        host->attempts > 0u && answer->sequence == host->sequence && answer->command == host->command;
    host->is_verdict_lost =
        host->is_answered && host->attempts > 1u && answer->verdict == LIDAR_VERDICT_BAD_SEQUENCE;
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
        unsigned unit = host->unit;
        (void)lidar_check(receiver->packet, receiver->packet_length, &unit);
        if (unit != host->unit)
            continue;
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
static inline bool lidar_host_begin(lidar_host *host, uint8_t command, const uint8_t *frame, size_t length) {
    if (length == 0u || host->attempts > 0u)
        return false;
    lidar_move(host->pending, frame, length);
    host->pending_length = length;
    host->command = command;
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
