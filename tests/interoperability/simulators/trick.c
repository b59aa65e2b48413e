/* Calls the jobs of examples/trick as Trick does: trick PORT LATITUDE_RAD LONGITUDE_RAD RADIUS_M MERIDIAN_RAD ROTATION_RADPS.
 * Standard input has a line per step: time, position, velocity, attitude, rate. */
#include "lidar_truth_job.h"

#include <stdio.h>
#include <stdlib.h>

int main(int count, char **arguments) {
    double time, r[3], v[3], q[4], w[3];
    if (count != 7)
        return 2;
    LIDAR_TRUTH_JOB job = {.port = atoi(arguments[1]), .latitude = atof(arguments[2]), .longitude = atof(arguments[3]),
                           .radius = atof(arguments[4]), .meridian = atof(arguments[5]), .rotation = atof(arguments[6])};
    if (lidar_truth_job_init(&job) < 0)
        return 1;
    while (scanf("%lf %lf %lf %lf %lf %lf %lf %lf %lf %lf %lf %lf %lf %lf", &time, &r[0], &r[1], &r[2], &v[0], &v[1],
                 &v[2], &q[0], &q[1], &q[2], &q[3], &w[0], &w[1], &w[2]) == 14)
        if (lidar_truth_job_send(&job, time, r, v, q, w) < 0)
            return 1;
    return lidar_truth_job_end(&job) < 0;
}
