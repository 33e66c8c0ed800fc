// The landmarks of one image that an estimate and the truth both have, without the others.
#pragma once

#include "../base/scalar.hpp"
#include "../base/workspace.hpp"

namespace shapefit {

struct Pairs {
    long count = 0;
    double *e[3], *x[3];  // estimate and truth
    long* index;          // among all landmarks
};

inline Pairs room_for_pairs(Workspace& workspace, long p) {
    Pairs pairs;
    for (double*& axis : pairs.e) axis = workspace.zeros<double>(p);
    for (double*& axis : pairs.x) axis = workspace.zeros<double>(p);
    pairs.index = workspace.zeros<long>(p);
    return pairs;
}

// Gather e and R x, of a rotation R (3, 3) or of none.
inline void gather(Matrix<const double> e, Matrix<const double> x, const double* R, Pairs& pairs) {
    pairs.count = 0;
    for (long j = 0; j < e.size[1]; ++j) {
        const double own[3] = {x[0][j], x[1][j], x[2][j]};
        const long at = pairs.count;
        bool known = true;
        for (int a = 0; a < 3; ++a) {
            const double* row = R + 3 * a;
            pairs.e[a][at] = e[a][j];
            pairs.x[a][at] = R ? row[0] * own[0] + row[1] * own[1] + row[2] * own[2] : own[a];
            known &= is_finite(pairs.e[a][at]) && is_finite(pairs.x[a][at]);
        }
        pairs.index[at] = j;
        pairs.count += known;
    }
}

// Whether all points are one, up to rounding.
inline bool coincide(double* const* points, long count) {
    constexpr double ROUNDING = 4 * 0x1p-52;
    double extent = 0, size = 0;
    for (int a = 0; a < 3; ++a) {
        double least = INFINITE, most = -INFINITE;
        for (long j = 0; j < count; ++j) {
            least = smaller(least, points[a][j]);
            most = larger(most, points[a][j]);
        }
        extent = larger(extent, most - least);
        size = larger(size, larger(magnitude(least), magnitude(most)));
    }
    return extent <= ROUNDING * size;
}

// Subtract the centroid.
inline void centre(double* const* points, long count) {
    for (int a = 0; a < 3; ++a) {
        double total = 0;
        for (long j = 0; j < count; ++j) total += points[a][j];
        for (long j = 0; j < count; ++j) points[a][j] -= total / count;
    }
}

// sum_j |e_j|^2.
inline double size_of(double* const* points, long count) {
    double total = 0;
    for (int a = 0; a < 3; ++a)
        for (long j = 0; j < count; ++j) total += square(points[a][j]);
    return total;
}

}  // namespace shapefit
