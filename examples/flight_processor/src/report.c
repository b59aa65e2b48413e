#include "report.h"
#include "board.h"

void report_word(const char *word) {
    for (; *word != '\0'; word++)
        board_write_report(*word);
}

void report_number(int64_t number) {
    char digits[20];
    size_t count = 0u;
    uint64_t rest = number < 0 ? (uint64_t)-number : (uint64_t)number;
    board_write_report(' ');
    if (number < 0)
        board_write_report('-');
    do {
        digits[count++] = (char)('0' + (int)(rest % 10u));
        rest /= 10u;
    } while (rest != 0u);
    while (count > 0u)
        board_write_report(digits[--count]);
}

/* A value in whole steps, rounded; "none" without a value, or with one that does not fit 32 bits. */
void report_steps(bool has_value, lidar_real value, int steps_per_unit) {
    const lidar_real steps = value * (lidar_real)steps_per_unit, limit = (lidar_real)2e9;
    if (has_value && steps > -limit && steps < limit)
        report_number((int32_t)(steps + (steps < (lidar_real)0 ? (lidar_real)-0.5 : (lidar_real)0.5)));
    else
        report_word(" none");
}

void report_end(void) { board_write_report('\n'); }
