// Distances of estimated shapes from true ones.
#include "../base/registry.hpp"
#include "../base/lanes.hpp"
#include "../base/vectors.hpp"
#include "../base/memory.hpp"
#include "reconstruction.hpp"

namespace shapefit {

// What the measures of estimated shapes read and write, as Python lays it out.

// Estimates e and true shapes x of n images. Landmarks that are not finite on one side do not count;
// with fewer than `fewest` an image has no error.
struct SimilarityData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    long fewest = from("fewest");
    Vector<double> error = from("error", "n");
};

struct CameraData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    Tensor<const double> rotation = from("rotation", "n 3 3");  // from the truth to the camera
    long fewest = from("fewest");
    Tensor<double> apart = from("apart", "n 3 p");  // s e_j + t - R x_j, 0 where j does not count
    Vector<double> scale = from("scale", "n");      // s
    Vector<double> error = from("error", "n");
};

struct SpreadData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    Vector<double> spread = from("spread", "n");  // nan where all points are one
};

// The landmarks of one image that an estimate and the truth both have, without the others.

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

// How far estimated shapes are from the true ones, image by image.

// min over s, proper R, t of sum_j |s R e_j + t - x_j|^2; then the mean over j of that distance.
//
// Where the points of e are one, s = 1; where those of x are, s = 0 (Umeyama, 1991).
void find_similarity_errors(const SimilarityData& data, Range range);

// min over s >= 0, t of sum_j |s e_j + t - R x_j|^2; then the mean over j of that distance.
void find_camera_errors(const CameraData& data, Range range);

// The mean over the axes of the standard deviation of x.
void find_spread(const SpreadData& data, Range range);

namespace {

double similarity_error(const Pairs& pairs) {
    const long m = pairs.count;
    const bool point = coincide(pairs.e, m), onto_point = coincide(pairs.x, m);
    centre(pairs.e, m);
    centre(pairs.x, m);
    double A[9] = {}, sR[9], overlap = 0;
    for (int i = 0; i < 9 && !point && !onto_point; ++i) A[i] = dot(pairs.x[i / 3], pairs.e[i % 3], m);
    for (const double entry : A)
        if (!is_finite(entry)) return NOT_A_NUMBER;
    nearest_rotation({A, {3, 3}}, {sR, {3, 3}});
    for (int i = 0; i < 9; ++i) overlap += sR[i] * A[i];
    const double size = point ? 0 : size_of(pairs.e, m), scale = size != 0 ? overlap / size : 1;
    for (double& entry : sR) entry *= scale;
    double total = 0;
    for (long j = 0; j < m; ++j) {
        double squares = 0;
        for (int a = 0; a < 3; ++a)
            squares += square(sR[3 * a] * pairs.e[0][j] + sR[3 * a + 1] * pairs.e[1][j] +
                              sR[3 * a + 2] * pairs.e[2][j] - pairs.x[a][j]);
        total += root(squares);
    }
    return total / m;
}

}  // namespace

void find_similarity_errors(const SimilarityData& data, Range range) {
    Workspace workspace;
    Pairs pairs = room_for_pairs(workspace, data.truth.size[2]);
    for (long image = range.first; image < range.last; ++image) {
        gather(data.estimate[image], data.truth[image], nullptr, pairs);
        data.error[image] = pairs.count < data.fewest ? NOT_A_NUMBER : similarity_error(pairs);
    }
}

void find_camera_errors(const CameraData& data, Range range) {
    const long p = data.truth.size[2];
    Workspace workspace;
    Pairs pairs = room_for_pairs(workspace, p);
    for (long image = range.first; image < range.last; ++image) {
        gather(data.estimate[image], data.truth[image], data.rotation[image].data, pairs);
        const long m = pairs.count;
        centre(pairs.e, m);
        centre(pairs.x, m);
        double overlap = 0, total = 0;
        for (int a = 0; a < 3; ++a) overlap += dot(pairs.e[a], pairs.x[a], m);
        const double size = size_of(pairs.e, m), s = size > 0 ? larger(overlap, 0) / size : 0;
        Matrix<double> apart = data.apart[image];
        for (long i = 0; i < 3 * p; ++i) apart.data[i] = 0;
        for (long j = 0; j < m; ++j) {
            double squares = 0;
            for (int a = 0; a < 3; ++a)
                squares += square(apart[a][pairs.index[j]] = s * pairs.e[a][j] - pairs.x[a][j]);
            total += root(squares);
        }
        data.scale[image] = s;
        data.error[image] = m < data.fewest ? NOT_A_NUMBER : total / m;
    }
}

void find_spread(const SpreadData& data, Range range) {
    Workspace workspace;
    Pairs pairs = room_for_pairs(workspace, data.truth.size[2]);
    for (long image = range.first; image < range.last; ++image) {
        gather(data.estimate[image], data.truth[image], nullptr, pairs);
        const long m = pairs.count;
        double& spread = data.spread[image];
        spread = coincide(pairs.x, m) ? NOT_A_NUMBER : 0;
        centre(pairs.x, m);
        for (const double* axis : pairs.x) spread += root(dot(axis, axis, m) / m) / 3;
    }
}

const Exported<find_similarity_errors> find_similarity_errors_exported{"find_similarity_errors"};
const Exported<find_camera_errors> find_camera_errors_exported{"find_camera_errors"};
const Exported<find_spread> find_spread_exported{"find_spread"};

}  // namespace shapefit
