// Poses of known shapes, shapes of known coefficients, and how far shapes are from true ones.
#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "rotation_step.hpp"
#include "transforms.hpp"

namespace shapefit {

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, for each image.
struct PoseData {
    Arguments& from;
    Tensor<const double> shape_moments = from("shape_moments", "n 3 3");  // P = S S^T
    Tensor<const double> landmarks_by_shape = from("landmarks_by_shape", "n 2 3");  // D = w S^T
    Blocks<const double> starts = from("starts", "n v 3 3");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<double> size = from("size", "n");  // s
};

// S = R sum_i c_i B_i, for each image.
struct CombinationData {
    Arguments& from;
    Matrix<const double> coefficients = from("coefficients", "n k");  // c
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Tensor<const double> rotation = from("rotation", "n 3 3");  // R
    Tensor<double> shapes = from("shapes", "n 3 p");  // S
};

// Estimates e and true shapes x of n images. Landmarks that are not finite on one side do not count;
// with fewer than `fewest` an image has no error.
struct SimilarityData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    long fewest = from("fewest");
    Vector<double> error = from("error", "n");
};

namespace {

// S <- R S.
void rotate_points(const double* R, Matrix<double> S) {
    const long p = S.size[1];
    double *x = S.data, *y = x + p, *z = y + p;
    for (long j = 0; j < p; ++j) {
        const double a = x[j], b = y[j], c = z[j];
        x[j] = R[0] * a + R[1] * b + R[2] * c;
        y[j] = R[3] * a + R[4] * b + R[5] * c;
        z[j] = R[6] * a + R[7] * b + R[8] * c;
    }
}

// The landmarks of one image that an estimate and the truth both have, without the others.
struct Pairs {
    Pairs(Workspace& workspace, long p) {
        for (double*& axis : e) axis = workspace.zeros<double>(p);
        for (double*& axis : x) axis = workspace.zeros<double>(p);
    }

    long count = 0;
    double *e[3], *x[3];  // estimate and truth
};

void gather(Matrix<const double> e, Matrix<const double> x, Pairs& pairs) {
    pairs.count = 0;
    for (long j = 0; j < e.size[1]; ++j) {
        bool known = true;
        for (int a = 0; a < 3; ++a) {
            pairs.e[a][pairs.count] = e[a][j];
            pairs.x[a][pairs.count] = x[a][j];
            known &= is_finite(e[a][j]) && is_finite(x[a][j]);
        }
        pairs.count += known;
    }
}

// Whether all points are one, up to rounding.
bool coincide(double* const* points, long count) {
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
void centre(double* const* points, long count) {
    for (int a = 0; a < 3; ++a) {
        double total = 0;
        for (long j = 0; j < count; ++j) total += points[a][j];
        for (long j = 0; j < count; ++j) points[a][j] -= total / count;
    }
}

double similarity_error(const Pairs& pairs) {
    const long m = pairs.count;
    const bool point = coincide(pairs.e, m), onto_point = coincide(pairs.x, m);
    centre(pairs.e, m);
    centre(pairs.x, m);
    double A[9] = {}, overlap = 0;
    for (int i = 0; i < 9 && !point && !onto_point; ++i) A[i] = dot(pairs.x[i / 3], pairs.e[i % 3], m);
    for (const double entry : A)
        if (!is_finite(entry)) return NOT_A_NUMBER;
    Rotation sR = nearest_rotation(A);
    for (int i = 0; i < 9; ++i) overlap += sR[i] * A[i];
    double size = 0;
    for (int a = 0; a < 3 && !point; ++a) size += dot(pairs.e[a], pairs.e[a], m);
    const double scale = size != 0 ? overlap / size : 1;
    for (double& entry : sR.entry) entry *= scale;
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

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, the best of several starts.
void find_pose(const PoseData& data, Range range) {
    for (long image = range.first; image < range.last; ++image) {
        const ShapeMoments moments{data.shape_moments[image].data, data.landmarks_by_shape[image].data,
                                   true};
        double least = INFINITE;
        for (long start = 0; start < data.starts.size[1]; ++start) {
            Rotation R = Rotation::from(data.starts[image][start].data);
            const Misfit misfit = rotation_step(moments, R);
            if (!(misfit.value < least)) continue;
            least = misfit.value;
            data.size[image] = misfit.scale;
            R.write(data.rotation[image].data);
        }
    }
}

// S = R sum_i c_i B_i.
void combine(const CombinationData& data, Range range) {
    const long k = data.atoms.size[0], size = 3 * data.atoms.size[2];
    for (long image = range.first; image < range.last; ++image) {
        const Vector<const double> c = data.coefficients[image];
        const Matrix<double> S = data.shapes[image];
        for (long e = 0; e < size; ++e) S.data[e] = 0;
        for (long i = 0; i < k; ++i)
            if (c[i] != 0) add_to(S.data, c[i], data.atoms[i].data, size);
        rotate_points(data.rotation[image].data, S);
    }
}

// min over s, proper R, t of sum_j |s R e_j + t - x_j|^2; then the mean over j of that distance.
//
// Where the points of e are one, s = 1; where those of x are, s = 0 (Umeyama, 1991).
void find_similarity_errors(const SimilarityData& data, Range range) {
    Workspace workspace;
    Pairs pairs(workspace, data.truth.size[2]);
    for (long image = range.first; image < range.last; ++image) {
        gather(data.estimate[image], data.truth[image], pairs);
        data.error[image] = pairs.count < data.fewest ? NOT_A_NUMBER : similarity_error(pairs);
    }
}

const Exported<find_pose> find_pose_exported{"find_pose"};
const Exported<combine> combine_exported{"combine"};
const Exported<find_similarity_errors> find_similarity_errors_exported{"find_similarity_errors"};

}  // namespace shapefit
