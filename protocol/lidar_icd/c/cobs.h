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
