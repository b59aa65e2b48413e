/* What the firmware asks of a board: two serial lines, one to the lidar and one for reports. */
#ifndef BOARD_H
#define BOARD_H

#include <stddef.h>
#include <stdint.h>

void board_start(void);

/* Next byte from the lidar; -1 if there is none yet. */
int board_read_lidar(void);

void board_write_lidar(const uint8_t *data, size_t length);
void board_write_report(char letter);

#endif
