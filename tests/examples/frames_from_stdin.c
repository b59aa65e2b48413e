/* A board and a CAN controller for the firmware of examples/flight_processor: frames from the standard input (identifier in two
 * bytes, length, eight bytes), reports and sent frames on the standard output. Every third frame finds the bus busy. */
#include "board.h"
#include "can_controller.h"

#include <stdio.h>
#include <stdlib.h>

void board_start(void) {}
void board_write_report(char letter) { (void)putchar(letter); }
void can_start(void) {}
uint32_t can_overruns(void) { return 0u; }

bool can_read(can_frame *frame) {
    uint8_t record[11];
    if (fread(record, sizeof record, 1u, stdin) != 1u)
        exit(0);
    frame->id = (unsigned)record[0] << 8 | record[1];
    frame->length = record[2];
    for (size_t k = 0u; k < sizeof frame->data; k++)
        frame->data[k] = record[3u + k];
    return true;
}

bool can_write(const can_frame *frame) {
    static unsigned count;
    if (++count % 3u == 0u)
        return false;
    printf("sent %u ", frame->id);
    for (size_t k = 0u; k < frame->length; k++)
        printf("%02x", frame->data[k]);
    printf("\n");
    return true;
}
