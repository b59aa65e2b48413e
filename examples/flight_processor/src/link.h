/* What the flight software asks of the link to the lidar: serial.c or can.c, each with its main. */
#ifndef LINK_H
#define LINK_H

#include "lidar.h"

void link_send_set_mode(uint8_t sequence, uint64_t mode);
void link_send_set_pattern(uint8_t sequence, uint64_t pattern);

/* Send a solution, unless the one before is still on its way. */
void link_send_navigation(const lidar_message_navigation *message);

/* Frames so far from which nothing was taken. */
uint32_t link_bad_frames(void);

#endif
