#include "navigation.h"

enum { BEAMS = 4 };

static const lidar_real radians_per_degree = (lidar_real)0.017453292519943295;
static const lidar_real half_diagonal = (lidar_real)0.70710678118654752; /* cosine of 45 degrees */

/* Sine of an angle up to 45 degrees, to single precision: the Taylor series. */
static lidar_real sine(lidar_real angle_rad) {
    const lidar_real square = angle_rad * angle_rad;
    lidar_real term = angle_rad, sum = angle_rad;
    for (int k = 2; k <= 8; k += 2) {
        term *= -square / (lidar_real)(k * (k + 1));
        sum += term;
    }
    return sum;
}

static lidar_real cosine(lidar_real angle_rad) {
    const lidar_real half = sine(angle_rad / (lidar_real)2);
    return (lidar_real)1 - (lidar_real)2 * half * half;
}

/* Closing speeds of all four beams. Opposite beams of a square have the same sum, so that three speeds give the fourth. */
static bool closing_speeds(const lidar_measurement *measurement, lidar_real *speeds_mps) {
    int missing = -1, count = 0;
    for (int k = 0; k < BEAMS; k++) {
        const lidar_beam *beam = &measurement->beams[k];
        if (beam->speed_valid && beam->has_closing_speed_mps) {
            speeds_mps[k] = beam->closing_speed_mps;
            count++;
        } else {
            missing = k;
        }
    }
    if (count == BEAMS - 1)
        speeds_mps[missing] =
            speeds_mps[(missing + 1) % BEAMS] + speeds_mps[(missing + 3) % BEAMS] - speeds_mps[(missing + 2) % BEAMS];
    return count >= BEAMS - 1;
}

static void solve_velocity(navigation_solution *solution, const lidar_real *speeds_mps, lidar_real angle_rad) {
    static const int x_signs[BEAMS] = {1, -1, -1, 1}, y_signs[BEAMS] = {1, 1, -1, -1};
    lidar_real x = 0, y = 0, z = 0;
    for (int k = 0; k < BEAMS; k++) {
        x += (lidar_real)x_signs[k] * speeds_mps[k];
        y += (lidar_real)y_signs[k] * speeds_mps[k];
        z += speeds_mps[k];
    }
    solution->velocity_mps[0] = x * half_diagonal / ((lidar_real)2 * sine(angle_rad));
    solution->velocity_mps[1] = y * half_diagonal / ((lidar_real)2 * sine(angle_rad));
    solution->velocity_mps[2] = z / ((lidar_real)BEAMS * cosine(angle_rad));
}

navigation_solution navigation_solve(const lidar_measurement *measurement) {
    navigation_solution solution = {0};
    lidar_real speeds_mps[BEAMS] = {0}, sum_m = 0;
    const lidar_real angle_rad = measurement->beams[0].beam_angle_deg * radians_per_degree;
    int ranges = 0;
    if (measurement->beam_count != (size_t)BEAMS || !measurement->beams[0].has_beam_angle_deg ||
        !(angle_rad > (lidar_real)0 && angle_rad < (lidar_real)0.785))
        return solution;
    for (int k = 0; k < BEAMS; k++) {
        const lidar_beam *beam = &measurement->beams[k];
        if (beam->range_valid && beam->has_range_m) {
            sum_m += beam->range_m;
            ranges++;
        }
    }
    solution.has_altitude = ranges > 0;
    if (solution.has_altitude)
        solution.altitude_m = sum_m / (lidar_real)ranges * cosine(angle_rad);
    solution.has_velocity = closing_speeds(measurement, speeds_mps);
    if (solution.has_velocity)
        solve_velocity(&solution, speeds_mps, angle_rad);
    return solution;
}
