#define LIDAR_DELIMITER 0xC0u

/* Decode a frame in place; returns the length of its content, 0 if an escape is invalid. */
static inline size_t lidar_unstuff(uint8_t *data, size_t length) {
    size_t position = 0u, written = 0u;
    while (position < length) {
        uint8_t byte = data[position++];
        if (byte == 0xDBu) {
            if (position == length || (data[position] != 0xDCu && data[position] != 0xDDu))
                return 0u;
            byte = data[position++] == 0xDCu ? 0xC0u : 0xDBu;
        }
        data[written++] = byte;
    }
    return written;
}

/* Frame a packet, with a delimiter before it too; returns the number of bytes. */
static inline size_t lidar_frame(uint8_t *to, const uint8_t *packet, size_t length) {
    size_t end = 0u;
    to[end++] = 0xC0u;
    for (size_t k = 0u; k < length; k++) {
        const bool is_special = packet[k] == 0xC0u || packet[k] == 0xDBu;
        if (is_special)
            to[end++] = 0xDBu;
        to[end++] = !is_special ? packet[k] : packet[k] == 0xC0u ? 0xDCu : 0xDDu;
    }
    to[end++] = 0xC0u;
    return end;
}
