static inline uint64_t lidar_bits(const uint8_t *block, size_t first_bit, unsigned bits) {
    uint64_t word = 0u;
    for (size_t k = 0u; k < bits; k++) {
        const size_t bit = first_bit + k;
        word |= ((uint64_t)block[bit / 8u] >> (bit % 8u) & 1u) << k;
    }
    return word;
}
