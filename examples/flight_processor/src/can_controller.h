/* What the firmware asks of a CAN controller: classic frames with identifiers of 11 bits. */
#ifndef CAN_CONTROLLER_H
#define CAN_CONTROLLER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    unsigned id;
    size_t length;
    uint8_t data[8];
} can_frame;

void can_start(void);

/* Take the next frame from the lidar; false if there is none yet. */
bool can_read(can_frame *frame);

/* Send a frame; false, and nothing is sent, while the one before waits for the bus. */
bool can_write(const can_frame *frame);

/* How often so far the controller had no room for a frame. */
uint32_t can_overruns(void);

#endif
