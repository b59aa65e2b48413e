#include "board.h"
#include "flight.h"

int main(void) {
    static flight self;
    board_start();
    for (;;) {
        const int byte = board_read_lidar();
        if (byte >= 0)
            flight_receive(&self, (uint8_t)byte);
    }
}
