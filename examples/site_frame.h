/* Truth for an emulated lidar from the state in an inertial frame whose z axis is the body's axis of rotation.
 *
 * The site frame (east, north, up) rotates with the body: a vehicle that hovers over the site has no velocity there, and
 * 240 m/s in the inertial frame at the equator of Mars. */
#ifndef SITE_FRAME_H
#define SITE_FRAME_H

#include "lidar_truth.h"

#include <math.h>

/* Where the site is. The body is a sphere here: latitude is planetocentric, up is away from its centre. */
struct site_frame {
    double latitude_rad, longitude_rad; /* of the site's origin */
    double radius_m;                    /* of the site's origin, from the centre */
    double meridian_rad;                /* longitude 0 at scenario time 0, from the inertial x axis */
    double rotation_radps;              /* of the body */
};

/* Product of two quaternions, scalar first. */
static inline void site_multiply(const double a[4], const double b[4], double product[4]) {
    product[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    product[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    product[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    product[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

static inline void site_conjugate(const double a[4], double conjugate[4]) {
    conjugate[0] = a[0];
    for (int k = 1; k < 4; k++)
        conjugate[k] = -a[k];
}

/* A vector of axes a in axes b. */
static inline void site_rotate(const double b_from_a[4], const double vector_a[3], double vector_b[3]) {
    const double pure[4] = {0.0, vector_a[0], vector_a[1], vector_a[2]};
    double a_from_b[4], half[4], rotated[4];
    site_conjugate(b_from_a, a_from_b);
    site_multiply(b_from_a, pure, half);
    site_multiply(half, a_from_b, rotated);
    for (int k = 0; k < 3; k++)
        vector_b[k] = rotated[k + 1];
}

/* The quaternion from inertial axes into east, north and up. */
static inline void site_from_inertial(const struct site_frame *site, double time_s, double quaternion[4]) {
    const double quarter_rad = 1.57079632679489662, tilt_rad = quarter_rad - site->latitude_rad;
    const double east_rad =
        site->meridian_rad + site->longitude_rad + site->rotation_radps * time_s + quarter_rad;
    const double about_x[4] = {cos(tilt_rad / 2), -sin(tilt_rad / 2), 0.0, 0.0};
    const double about_z[4] = {cos(east_rad / 2), 0.0, 0.0, -sin(east_rad / 2)};
    site_multiply(about_x, about_z, quaternion);
}

/* Fill in the state of a truth: position and velocity in inertial axes from the body's centre, the attitude as the
 * quaternion (scalar first) from vehicle into inertial axes, and the inertial rate about the vehicle's axes. */
static inline void site_fill_truth(const struct site_frame *site, double time_s, const double position_m[3],
                                   const double velocity_mps[3], const double inertial_from_body[4],
                                   const double rate_radps[3], struct lidar_truth *truth) {
    const double rotation_radps[3] = {0.0, 0.0, site->rotation_radps};
    const double velocity_over_ground_mps[3] = {velocity_mps[0] + site->rotation_radps * position_m[1],
                                                velocity_mps[1] - site->rotation_radps * position_m[0],
                                                velocity_mps[2]};
    double quaternion[4], body_from_inertial[4], carried_radps[3];
    site_from_inertial(site, time_s, quaternion);
    site_rotate(quaternion, position_m, truth->position_site_m);
    truth->position_site_m[2] -= site->radius_m;
    site_rotate(quaternion, velocity_over_ground_mps, truth->velocity_site_mps);
    site_multiply(quaternion, inertial_from_body, truth->site_from_body);
    site_conjugate(inertial_from_body, body_from_inertial);
    site_rotate(body_from_inertial, rotation_radps, carried_radps);
    for (int k = 0; k < 3; k++)
        truth->body_rate_radps[k] = rate_radps[k] - carried_radps[k];
}

#endif
