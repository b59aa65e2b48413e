/* Velocity and altitude from the four beams of a square pattern around the boresight. */
#ifndef NAVIGATION_H
#define NAVIGATION_H

#include "lidar.h"

typedef struct {
    bool has_velocity, has_altitude;
    lidar_real velocity_mps[3]; /* sensor frame: z along the boresight, beam k at an azimuth of 45 + 90 k degrees from x */
    lidar_real altitude_m;      /* above level ground, with the boresight downwards */
} navigation_solution;

navigation_solution navigation_solve(const lidar_measurement *measurement);

#endif
