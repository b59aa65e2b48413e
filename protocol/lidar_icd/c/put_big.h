static inline void lidar_put(uint8_t *block, size_t first_bit, unsigned bits, uint64_t word) {
    for (size_t k = 0u; k < bits; k++) {
        const size_t bit = first_bit + bits - 1u - k;
        block[bit / 8u] = (uint8_t)(block[bit / 8u] | (word >> k & 1u) << (7u - bit % 8u));
    }
}
