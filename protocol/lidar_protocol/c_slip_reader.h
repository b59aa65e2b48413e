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
    if (byte == 0xC0u)
        receiver->is_complete = true;
    else if (receiver->length < sizeof receiver->data)
        receiver->data[receiver->length++] = byte;
    else
        receiver->is_too_long = true;
}

/* Whether there is a good packet: `packet`, `packet_length`. */
static inline bool lidar_next(lidar_receiver *receiver) {
    size_t end = receiver->length, written = 0u;
    unsigned unit;
    if (!receiver->is_complete || receiver->is_too_long)
        return false;
    for (size_t position = 0u; position < end; position++) {
        uint8_t byte = receiver->data[position];
        if (byte == 0xDBu) {
            position++;
            if (position == end || (receiver->data[position] != 0xDCu && receiver->data[position] != 0xDDu))
                return false;
            byte = receiver->data[position] == 0xDCu ? 0xC0u : 0xDBu;
        }
        receiver->data[written++] = byte;
    }
    receiver->length = 0u;
    receiver->packet = receiver->data;
    receiver->packet_length = written;
    return lidar_check(receiver->packet, written, &unit) != LIDAR_NOTHING;
}
