#include "gain.hpp"

#include "../base/logarithm.hpp"

namespace shapefit {
namespace {

constexpr double PI = 0x1.921fb54442d18p1;

}  // namespace

double find_area(const SeenLandmarks& seen) {
    const long m = seen.count;
    double x = 0, y = 0, xx = 0, yy = 0, xy = 0;
    for (long j = 0; j < m; ++j) {
        x += seen.x[j] / m;
        y += seen.y[j] / m;
    }
    for (long j = 0; j < m; ++j) {
        xx += square(seen.x[j] - x) / m;
        yy += square(seen.y[j] - y) / m;
        xy += (seen.x[j] - x) * (seen.y[j] - y) / m;
    }
    return 12 * root(larger(xx * yy - xy * xy, 0));
}

double judge(const SeenLandmarks& seen, const WeakPose& pose, const Tolerance& tolerance,
             double* __restrict inside) {
    const double limit = square(tolerance.threshold * pose.size), inverse = 1 / limit;
    if (!(PI * limit < tolerance.area)) {
        for (long j = 0; j < seen.count; ++j) inside[j] = 0;
        return -INFINITE;
    }
    double M[6], total = 0;
    for (int e = 0; e < 6; ++e) M[e] = pose.size * pose.R[e];
    const double *X = seen.S[0], *Y = seen.S[1], *Z = seen.S[2];
    for (long j = 0; j < seen.count; ++j) {
        const double x = seen.x[j] - pose.T[0] - M[0] * X[j] - M[1] * Y[j] - M[2] * Z[j];
        const double y = seen.y[j] - pose.T[1] - M[3] * X[j] - M[4] * Y[j] - M[5] * Z[j];
        const double residual = x * x + y * y;
        inside[j] = residual <= limit ? 1.0 : 0.0;
        total += seen.h[j] * larger(1 - residual * inverse, 0);
    }
    return (total - TRIPLE) * log(tolerance.area * inverse / PI);
}

void judge_lanes(const SeenLandmarks& seen, const PoseLanes& poses, const Tolerance& tolerance,
                 Lanes& gains) {
    const Lanes limit = square(tolerance.threshold * poses.size), inverse = 1 / limit, zero{};
    Lanes M[6], total = zero - TRIPLE;
    for (int e = 0; e < 6; ++e) M[e] = poses.size * poses.R[e];
    const Lanes Tx = poses.T[0], Ty = poses.T[1];
    for (long j = 0; j < seen.count; ++j) {
        const double X = seen.S[0][j], Y = seen.S[1][j], Z = seen.S[2][j];
        const Lanes x = seen.x[j] - Tx - M[0] * X - M[1] * Y - M[2] * Z;
        const Lanes y = seen.y[j] - Ty - M[3] * X - M[4] * Y - M[5] * Z;
        total += seen.h[j] * larger(1 - (x * x + y * y) * inverse, zero);
    }
    // area / (pi limit) > 1 where the logarithm counts
    const Lanes surprise = tolerance.area * inverse / PI - 1;
    for (int l = 0; l < WIDTH; ++l) {
        const bool judged = poses.size[l] > 0 && PI * limit[l] < tolerance.area;
        gains[l] = judged ? total[l] * log_of_one_plus(surprise[l]) : -INFINITE;
    }
}

}  // namespace shapefit
