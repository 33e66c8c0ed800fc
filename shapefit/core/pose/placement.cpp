#include "placement.hpp"

#include "../base/registry.hpp"
#include "../base/scalar.hpp"
#include "../base/vectors.hpp"

namespace shapefit {
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
