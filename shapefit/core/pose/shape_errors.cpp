#include "shape_errors.hpp"

#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "reconstruction.hpp"
#include "pairs.hpp"

namespace shapefit {
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
