static inline uint64_t lidar_bits(const uint8_t *block, size_t first_bit, unsigned bits) {
    uint64_t word = 0u;
    for (size_t k = first_bit; k < first_bit + bits; k++)
        word = word << 1 | ((uint64_t)block[k / 8u] >> (7u - k % 8u) & 1u);
    return word;
}
