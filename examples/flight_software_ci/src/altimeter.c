#include "altimeter.h"

#include <math.h>

static const double RAD_PER_DEG = 3.14159265358979323846 / 180.0;

/* The heights seen by the valid beams, in ascending order; returns how many. */
static unsigned sorted_heights(const lidar_measurement *measurement, double *heights_m) {
    unsigned count = 0u;
    for (size_t k = 0u; k < measurement->beam_count; k++) {
        const lidar_beam *beam = &measurement->beams[k];
        if (!(beam->range_valid && beam->has_range_m && beam->has_beam_angle_deg))
            continue;
        const double height_m = beam->range_m * cos(beam->beam_angle_deg * RAD_PER_DEG);
        unsigned at = count++;
        for (; at > 0u && heights_m[at - 1u] > height_m; at--)
            heights_m[at] = heights_m[at - 1u];
        heights_m[at] = height_m;
    }
    return count;
}

bool altimeter_feed(altimeter *self, uint8_t byte, altimeter_height *height) {
    static double heights_m[sizeof self->measurement.beams / sizeof self->measurement.beams[0]];
    bool is_new = false;
    unsigned unit;
    lidar_feed(&self->receiver, byte);
    while (lidar_next(&self->receiver)) {
        const lidar_receiver *receiver = &self->receiver;
        if (!lidar_read_measurement(receiver->packet, receiver->packet_length, &unit, &self->measurement))
            continue; /* housekeeping or an acknowledgement */
        const unsigned count = sorted_heights(&self->measurement, heights_m);
        if (count < ALTIMETER_FEWEST_BEAMS)
            continue;
        height->shot = self->measurement.shot.shot;
        height->time_ns = self->measurement.shot.time_ns;
        height->beams = count;
        height->height_m = 0.5 * (heights_m[(count - 1u) / 2u] + heights_m[count / 2u]);
        is_new = true;
    }
    return is_new;
}
