#define _POSIX_C_SOURCE 200809L
#include "lidar_truth_link.h"
#include "site_frame.h"

#include "lidar_truth_job.h"

static struct lidar_truth truth; /* the newest */

static int send_truth(LIDAR_TRUTH_JOB *job) {
    truth.sequence = job->sequence++;
    return lidar_truth_send_and_wait(job->link, &truth) < 0 ? -1 : 0;
}

int lidar_truth_job_init(LIDAR_TRUTH_JOB *job) {
    job->sequence = 0;
    job->link = lidar_truth_open((uint16_t)(job->port == 0 ? 5600 : job->port));
    return job->link < 0 ? -1 : 0;
}

int lidar_truth_job_send(LIDAR_TRUTH_JOB *job, double time, const double position[3], const double velocity[3],
                         const double inertial_from_body[4], const double rate[3]) {
    const struct site_frame site = {job->latitude, job->longitude, job->radius, job->meridian, job->rotation};
    lidar_truth_begin(&truth, job->sequence, llround(time * 1e9));
    site_fill_truth(&site, time, position, velocity, inertial_from_body, rate, &truth);
    return send_truth(job);
}

int lidar_truth_job_end(LIDAR_TRUTH_JOB *job) {
    truth.flags |= LIDAR_TRUTH_LAST; /* counts on a repeat of the same time */
    const int result = send_truth(job);
    close(job->link);
    return result;
}
