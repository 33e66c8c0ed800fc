// Poses of known shapes, and where shapes lie in the image.
#include "../base/registry.hpp"
#include "../base/lanes.hpp"
#include "../base/vectors.hpp"
#include "rotation.hpp"
#include "../shared/data.hpp"
#include "../shared/rotation_step.hpp"

namespace shapefit {

// The pose of one known shape in each image: rotation and scale, the best of several starts.

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, for the images of the range.
void find_pose(const PoseData& data, Range range);

// P and D; zero for an image without landmarks.
void find_shape_moments(const MomentsData& data, Range range);

// The turn by atan2(A_10 - A_01, A_00 + A_11), A = D Rbar^T.
void turn_in_plane(const ViewsData& data, Range range);

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

// Shapes from coefficients, and shapes placed on landmarks.

// S = R sum_i c_i B_i.
void combine(const CombinationData& data, Range range);

// T = the mean of W - S with the weights squared; what is left there.
void place(const PlacementData& data, Range range);

namespace {

// S <- R S.
void turn(const double* R, Matrix<double> S) {
    const long p = S.size[1];
    double *x = S.data, *y = x + p, *z = y + p;
    for (long j = 0; j < p; ++j) {
        const double a = x[j], b = y[j], c = z[j];
        x[j] = R[0] * a + R[1] * b + R[2] * c;
        y[j] = R[3] * a + R[4] * b + R[5] * c;
        z[j] = R[6] * a + R[7] * b + R[8] * c;
    }
}

// One axis of the landmarks w less that of a shape s, where there is one.
struct Axis {
    const double *omega, *w, *s;
    long p;
    double left(long j) const { return s ? w[j] - s[j] : w[j]; }

    // Its mean with the weights squared.
    double mean(double total) const {
        double sum = 0;
        for (long j = 0; j < p; ++j) sum += square(omega[j]) * left(j);
        return sum / total;
    }

    // 1/2 ||omega o (w - s - t)||^2.
    double misfit(double t) const {
        double sum = 0;
        for (long j = 0; j < p; ++j) sum += square(omega[j] * (left(j) - t));
        return 0.5 * sum;
    }
};

void place_image(const PlacementData& data, long image) {
    const double* omega = data.weights[image].data;
    const long p = data.weights.size[1];
    const double total = dot(omega, omega, p);
    double left = 0, whole = 0;
    for (int a = 0; a < 2; ++a) {
        const double* w = data.landmarks[image][a].data;
        const Axis bare{omega, w, nullptr, p}, rest{omega, w, data.shapes[image][a].data, p};
        double& t = data.translation[image][a];
        if (!data.is_known) t = total > 0 ? rest.mean(total) : NOT_A_NUMBER;
        left += rest.misfit(t);
        whole += bare.misfit(total > 0 ? bare.mean(total) : NOT_A_NUMBER);
    }
    data.misfit[image] = left;
    data.residual[image] = whole == 0 ? 0 : root(left / whole);
}

}  // namespace

void combine(const CombinationData& data, Range range) {
    const long k = data.atoms.size[0], size = 3 * data.atoms.size[2];
    for (long image = range.first; image < range.last; ++image) {
        const Vector<const double> c = data.coefficients[image];
        const Matrix<double> S = data.shapes[image];
        for (long e = 0; e < size; ++e) S.data[e] = 0;
        for (long i = 0; i < k; ++i)
            if (c[i] != 0) add_to(S.data, c[i], data.atoms[i].data, size);
        turn(data.rotation[image].data, S);
    }
}

void place(const PlacementData& data, Range range) {
    for (long image = range.first; image < range.last; ++image) place_image(data, image);
}

const Exported<combine> combine_exported{"combine"};
const Exported<place> place_exported{"place"};

}  // namespace shapefit
