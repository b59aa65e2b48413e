static inline bool lidar_put_bits(uint8_t *block, size_t first_bit, unsigned bits, uint64_t word) {
    lidar_put(block, first_bit, bits, word);
    return true;
}

static inline bool lidar_put_unsigned(
    uint8_t *block, size_t first_bit, unsigned bits, uint64_t value, uint64_t lowest, uint64_t highest) {
    lidar_put(block, first_bit, bits, value);
    return value >= lowest && value <= highest;
}

static inline bool lidar_put_signed(
    uint8_t *block, size_t first_bit, unsigned bits, int64_t value, int64_t lowest, int64_t highest, int64_t offset) {
    lidar_put(block, first_bit, bits, (uint64_t)value - (uint64_t)offset);
    return value >= lowest && value <= highest;
}

/* Put a number of steps, rounded to the nearest integer; NaN is out of any range. */
static inline bool lidar_put_steps(
    uint8_t *block, size_t first_bit, unsigned bits, lidar_real steps, double lowest, double end) {
    const lidar_real raised = steps + (lidar_real)0.5;
    int64_t below;
    if (!((double)raised >= lowest && (double)raised < end))
        return false;
    below = raised < (lidar_real)0.0 ? (int64_t)raised : 0;
    if ((lidar_real)below > raised)
        below--;
    lidar_put(block, first_bit, bits, below < 0 ? (uint64_t)below : (uint64_t)raised);
    return true;
}

/* Put nanoseconds as a time code of 4 + 3 bytes. */
static inline bool lidar_put_time(uint8_t *block, size_t first_bit, int64_t time_ns) {
    const uint64_t seconds = (uint64_t)time_ns / 1000000000u, rest = (uint64_t)time_ns % 1000000000u;
    const uint64_t ticks = (seconds << 24) + ((rest << 24) + 500000000u) / 1000000000u;
    lidar_put(block, first_bit, 56u, ticks);
    return time_ns >= 0 && ticks < (uint64_t)1 << 56;
}

static inline bool lidar_put_float(
    uint8_t *block, size_t first_bit, unsigned bits, lidar_real value, double lowest, double highest) {
    const bool in_range = (double)value >= lowest && (double)value <= highest;
    const float number = in_range ? (float)value : 0.0f;
    uint32_t word;
    lidar_move(&word, &number, sizeof word);
    lidar_put(block, first_bit, bits, word);
    return in_range;
}

static inline bool lidar_put_double(
    uint8_t *block, size_t first_bit, unsigned bits, double value, double lowest, double highest) {
    uint64_t word;
    lidar_move(&word, &value, sizeof word);
    lidar_put(block, first_bit, bits, word);
    return value >= lowest && value <= highest;
}
