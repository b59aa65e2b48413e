/************************TRICK HEADER*************************
PURPOSE:
    (Jobs that send the vehicle's true state to an emulated lidar, in lockstep.)
LIBRARY DEPENDENCIES:
    ((lidar_truth_job.c))
*************************************************************/
#ifndef LIDAR_TRUTH_JOB_H
#define LIDAR_TRUTH_JOB_H

typedef struct {
    int port;              /* --    UDP port of the lidar's live truth; 0: 5600 */
    double latitude;       /* rad   Of the site's origin, planetocentric */
    double longitude;      /* rad   Of the site's origin */
    double radius;         /* m     Of the site's origin, from the body's centre */
    double meridian;       /* rad   Longitude 0 at simulation time 0, from the inertial x axis */
    double rotation;       /* rad/s Of the body about the inertial z axis */
    int link;              /* --    Socket, once initialised */
    unsigned int sequence; /* --    Of the next truth */
} LIDAR_TRUTH_JOB;

#ifdef __cplusplus
extern "C" {
#endif

/* Each job returns 0, or -1 with a message, by which Trick ends the simulation. */
int lidar_truth_job_init(LIDAR_TRUTH_JOB *job);

/* Send the state and wait for the lidar: position and velocity in inertial axes from the body's centre, quaternion
 * (scalar first) from vehicle into inertial axes, rate about the vehicle's axes. */
int lidar_truth_job_send(LIDAR_TRUTH_JOB *job, double time, const double position[3], const double velocity[3],
                         const double inertial_from_body[4], const double rate[3]);

/* End the flight of the lidar. */
int lidar_truth_job_end(LIDAR_TRUTH_JOB *job);

#ifdef __cplusplus
}
#endif

#endif
