typedef struct {
    uint8_t data[LIDAR_LONGEST_FRAME];
    size_t length;
    bool is_complete, is_too_long;
    const uint8_t *packet;
    size_t packet_length;
} lidar_receiver;

/* Takes a byte. What lidar_next() found before is no longer valid. */
static inline void lidar_feed(lidar_receiver *receiver, uint8_t byte) {
    if (receiver->is_complete) {
        receiver->is_complete = receiver->is_too_long = false;
        receiver->length = 0u;
    }
    if (byte == 0u)
        receiver->is_complete = true;
    else if (receiver->length < sizeof receiver->data)
        receiver->data[receiver->length++] = byte;
    else
        receiver->is_too_long = true;
}

/* Whether there is a good packet: `packet`, `packet_length`. */
static inline bool lidar_next(lidar_receiver *receiver) {
    size_t position = 0u, end = receiver->length, written = 0u;
    unsigned unit;
    if (!receiver->is_complete || receiver->is_too_long)
        return false;
    while (position < end) {
        const size_t code = receiver->data[position];
        if (position + code > end)
            return false;
        memmove(receiver->data + written, receiver->data + position + 1u, code - 1u);
        written += code - 1u;
        position += code;
        if (code < 255u && position < end)
            receiver->data[written++] = 0u;
    }
    receiver->length = 0u;
    receiver->packet = receiver->data;
    receiver->packet_length = written;
    return lidar_check(receiver->packet, written, &unit) != LIDAR_NOTHING;
}
