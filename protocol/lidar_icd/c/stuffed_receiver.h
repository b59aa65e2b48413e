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
