/* Lines of text on the second serial line; README.md lists their columns. */
#ifndef REPORT_H
#define REPORT_H

#include "navigation.h"

void report_word(const char *word);
void report_number(int64_t number);
void report_steps(bool has_value, lidar_real value, int steps_per_unit);
void report_end(void);

#endif
