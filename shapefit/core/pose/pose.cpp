#include "pose.hpp"

#include "../base/registry.hpp"
#include "../base/scalar.hpp"
#include "../shared/rotation_step.hpp"
#include "rotations.hpp"

namespace shapefit {

void find_pose(const PoseData& data, Range range) {
    for (long image = range.first; image < range.last; ++image) {
        const ShapeMoments moments{data.shape_moments[image].data, data.landmarks_by_shape[image].data,
                                   true};
        double least = INFINITE;
        for (long start = 0; start < data.starts.size[1]; ++start) {
            double R[9];
            for (int e = 0; e < 9; ++e) R[e] = data.starts[image][start].data[e];
            const Misfit misfit = rotation_step(moments, R);
            if (!(misfit.value < least)) continue;
            least = misfit.value;
            data.size[image] = misfit.scale;
            for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = R[e];
        }
    }
}

void find_shape_moments(const MomentsData& data, Range range) {
    const long p = data.shape.size[1];
    for (long image = range.first; image < range.last; ++image) {
        const double* omega = data.weights[image].data;
        const Matrix<const double> S = data.shape, W = data.landmarks[image];
        double total = 0, mean[3] = {}, P[9] = {}, D[6] = {};
        for (long j = 0; j < p; ++j) {
            total += square(omega[j]);
            for (int b = 0; b < 3; ++b) mean[b] += square(omega[j]) * S[b][j];
        }
        for (double& coordinate : mean) coordinate = total > 0 ? coordinate / total : 0;
        for (long j = 0; j < p; ++j) {
            const double x[3] = {S[0][j] - mean[0], S[1][j] - mean[1], S[2][j] - mean[2]};
            for (int b = 0; b < 3; ++b) {
                const double weighted = square(omega[j]) * x[b];
                for (int a = 0; a < 3; ++a) P[3 * a + b] += x[a] * weighted;
                for (int a = 0; a < 2; ++a) D[3 * a + b] += W[a][j] * weighted;
            }
        }
        for (int e = 0; e < 9; ++e) data.shape_moments[image].data[e] = P[e];
        for (int e = 0; e < 6; ++e) data.landmarks_by_shape[image].data[e] = D[e];
    }
}

void turn_in_plane(const ViewsData& data, Range range) {
    for (long image = range.first; image < range.last; ++image)
        for (long view = 0; view < data.views.size[0]; ++view) {
            const double *D = data.landmarks_by_shape[image].data, *R = data.views[view].data;
            double* turned = data.turned[image][view].data;
            const double sine = inner3(D + 3, R) - inner3(D, R + 3);
            const double cosine = inner3(D, R) + inner3(D + 3, R + 3);
            const double length = root(square(sine) + square(cosine));
            const double s = length > 0 ? sine / length : 0, c = length > 0 ? cosine / length : 1;
            for (int b = 0; b < 3; ++b) {
                turned[b] = c * R[b] - s * R[3 + b];
                turned[3 + b] = s * R[b] + c * R[3 + b];
                turned[6 + b] = R[6 + b];
            }
        }
}

const Exported<find_pose> find_pose_exported{"find_pose"};
const Exported<find_shape_moments> find_shape_moments_exported{"find_shape_moments"};
const Exported<turn_in_plane> turn_in_plane_exported{"turn_in_plane"};

}  // namespace shapefit
