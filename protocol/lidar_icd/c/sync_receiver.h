typedef struct {
    uint8_t data[LIDAR_LONGEST_FRAME];
    size_t length, used;
    const uint8_t *packet;
    size_t packet_length;
    uint32_t bad_frames; /* sync words without a valid packet after them */
} lidar_receiver;

static inline void lidar_drop(lidar_receiver *receiver, size_t count) {
    receiver->length -= count;
    lidar_move(receiver->data, receiver->data + count, receiver->length);
}

/* Add a received byte, after lidar_next() has returned false; the packet that it found before is no longer valid. */
static inline void lidar_feed(lidar_receiver *receiver, uint8_t byte) {
    if (receiver->length == sizeof receiver->data)
        lidar_drop(receiver, 1u);
    receiver->data[receiver->length++] = byte;
}

/* Find a valid packet: sets `packet` and `packet_length`, or returns false. */
static inline bool lidar_next(lidar_receiver *receiver) {
    const size_t head = LIDAR_SYNC_BYTES + LIDAR_LENGTH_BYTES;
    lidar_drop(receiver, receiver->used);
    receiver->used = 0u;
    for (;;) {
        size_t start = 0u, length;
        unsigned unit;
        while (start < receiver->length && !lidar_may_be_sync(receiver->data + start, receiver->length - start))
            start++;
        lidar_drop(receiver, start);
        if (receiver->length < head)
            return false;
        length = lidar_stated_length(receiver->data);
        if (length != 0u && length <= LIDAR_LONGEST_PACKET) {
            if (receiver->length < head + length)
                return false;
            if (lidar_check(receiver->data + head, length, &unit) != LIDAR_NOTHING) {
                receiver->packet = receiver->data + head;
                receiver->packet_length = length;
                receiver->used = head + length;
                return true;
            }
        }
        receiver->bad_frames++;
        lidar_drop(receiver, 1u); /* the sync word of a valid frame may overlap this one */
    }
}

/* Frame a packet; returns the number of bytes. */
static inline size_t lidar_frame(uint8_t *to, const uint8_t *packet, size_t length) {
    lidar_head(to, length);
    lidar_move(to + LIDAR_SYNC_BYTES + LIDAR_LENGTH_BYTES, packet, length);
    return LIDAR_SYNC_BYTES + LIDAR_LENGTH_BYTES + length;
}
