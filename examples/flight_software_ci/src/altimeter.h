/* Height above the ground from the slant ranges of a landing lidar: bytes in, heights out.
 *
 * The vehicle is upright. A beam at angle a and range r sees the ground r cos(a) below; the height is the median of
 * at least three valid beams, of which one may be wrong.
 */
#ifndef ALTIMETER_H
#define ALTIMETER_H

#include "lidar.h"

typedef struct {
    uint64_t shot;
    int64_t time_ns; /* time of validity */
    unsigned beams;  /* number of valid beams */
    double height_m;
} altimeter_height;

typedef struct {
    lidar_receiver receiver; /* receiver.bad_frames counts what was dropped */
    lidar_measurement measurement;
} altimeter;

enum { ALTIMETER_FEWEST_BEAMS = 3 };

/* Take one received byte; true if it completes a shot with a height. A zeroed altimeter is ready. */
bool altimeter_feed(altimeter *self, uint8_t byte, altimeter_height *height);

#endif
