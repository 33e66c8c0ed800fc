#include "active.hpp"

#include "blocks.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

constexpr double RANK_ONE = 1e-14;  // s2 / s1, below which any direction orthogonal to v serves
const double HALF_ROOT = root(0.5);

// X = U^T G V of block c: entries 11, 12, 13, 21, 22, 23.
struct Turned {
    double x[6];
};

[[gnu::always_inline]] inline Turned turn(const ActiveBlocks& a, const double* G, long c) {
    const long n = a.room;
    double top[3], low[3];
    const double *v = a.v + c, *w = a.w + c, *z = a.z + c;
    const double g0 = G[c], g1 = G[n + c], g2 = G[2 * n + c];
    const double h0 = G[3 * n + c], h1 = G[4 * n + c], h2 = G[5 * n + c];
    top[0] = g0 * v[0] + g1 * v[n] + g2 * v[2 * n];
    low[0] = h0 * v[0] + h1 * v[n] + h2 * v[2 * n];
    top[1] = g0 * w[0] + g1 * w[n] + g2 * w[2 * n];
    low[1] = h0 * w[0] + h1 * w[n] + h2 * w[2 * n];
    top[2] = g0 * z[0] + g1 * z[n] + g2 * z[2 * n];
    low[2] = h0 * z[0] + h1 * z[n] + h2 * z[2 * n];
    const double cosine = a.cosine[c], sine = a.sine[c];
    Turned result;
    for (int b = 0; b < 3; ++b) {
        result.x[b] = cosine * top[b] + sine * low[b];
        result.x[3 + b] = cosine * low[b] - sine * top[b];
    }
    return result;
}

}  // namespace

LaidAtoms::LaidAtoms(Workspace& workspace, long atoms, long most_columns)
    : atoms_(atoms),
      size_(3 * padded(most_columns)),
      data_(workspace.zeros<double>(atoms * size_)),
      laid_(workspace.zeros<bool>(atoms)) {}

void LaidAtoms::reset(const Planes& planes) {
    planes_ = planes;
    stride_ = padded(planes.columns);
    for (long i = 0; i < atoms_; ++i) laid_[i] = false;
}

const double* LaidAtoms::lay(long i) {
    double* out = data_ + i * size_;
    for (int b = 0; b < 3; ++b) {
        for (long j = 0; j < planes_.columns; ++j) out[b * stride_ + j] = planes_.column(b, j)[i];
        for (long j = planes_.columns; j < stride_; ++j) out[b * stride_ + j] = 0;
    }
    laid_[i] = true;
    return out;
}

ActiveBlocks::ActiveBlocks(Workspace& workspace, long padded_atoms) : room(padded_atoms) {
    index = workspace.zeros<long>(room);
    const auto rows = [&](long count) { return workspace.zeros<double>(count * room); };
    argument = rows(6), prox = rows(6), weight = rows(6);
    v = rows(3), w = rows(3), z = rows(3);
    cosine = rows(1), sine = rows(1);
}

void ActiveBlocks::find(const double* M, const double* N, double sigma, double t,
                        const double* total, long k) {
    count = 0;
    for (long i = 0; i < k; ++i) {
        index[count < room ? count : room - 1] = i;
        count += total[i] > t;
    }
    for (long c = 0; c < count; ++c)
        for (int e = 0; e < 6; ++e)
            argument[e * room + c] = M[e * k + index[c]] + sigma * N[e * k + index[c]];
    const long n = room;
    const double *Q = argument;
    norms = 0;
    for (long c = 0; c < count; ++c) {
        const double x0 = Q[c], x1 = Q[n + c], x2 = Q[2 * n + c];
        const double y0 = Q[3 * n + c], y1 = Q[4 * n + c], y2 = Q[5 * n + c];
        const double A = x0 * x0 + x1 * x1 + x2 * x2, C = y0 * y0 + y1 * y1 + y2 * y2;
        const double D = x0 * y0 + x1 * y1 + x2 * y2;
        const double c0 = x1 * y2 - x2 * y1, c1 = x2 * y0 - x0 * y2, c2 = x0 * y1 - x1 * y0;
        const double product = root(c0 * c0 + c1 * c1 + c2 * c2);
        const double plus = root(A + C + 2 * product);
        const double half = 0.5 * (A - C), radius = root(half * half + D * D);
        const double minus = 2 * radius / plus;
        const double s1 = 0.5 * (plus + minus);
        // u1 = (cosine, sine) is an eigenvector of [[A, D], [D, C]].
        const double a = half >= 0 ? half + radius : D, b = half >= 0 ? D : radius - half;
        const double span = a * a + b * b;
        const double unit = span > 0 ? 1 / root(span) : 0;
        const double u = span > 0 ? a * unit : 1, s = b * unit;
        double v0 = u * x0 + s * y0, v1 = u * x1 + s * y1, v2 = u * x2 + s * y2;
        const double first = 1 / root(v0 * v0 + v1 * v1 + v2 * v2);
        v0 *= first, v1 *= first, v2 *= first;
        double w0 = u * y0 - s * x0, w1 = u * y1 - s * x1, w2 = u * y2 - s * x2;
        const double along = w0 * v0 + w1 * v1 + w2 * v2;
        w0 -= along * v0, w1 -= along * v1, w2 -= along * v2;
        const double second = root(w0 * w0 + w1 * w1 + w2 * w2);
        const bool thin = second <= RANK_ONE * s1, flat = magnitude(v0) < 0.7;
        w0 = thin ? (flat ? 0 : -v1) : w0;
        w1 = thin ? (flat ? -v2 : v0) : w1;
        w2 = thin ? (flat ? v1 : 0) : w2;
        const double length = 1 / root(w0 * w0 + w1 * w1 + w2 * w2);
        w0 *= length, w1 *= length, w2 *= length;
        const bool equal = minus <= t;
        const double f1 = equal ? larger(0.5 * (plus - t), 0) : s1 - t;
        const double f2 = equal ? f1 : product / s1;
        cosine[c] = u, sine[c] = s;
        v[c] = v0, v[n + c] = v1, v[2 * n + c] = v2;
        w[c] = w0, w[n + c] = w1, w[2 * n + c] = w2;
        z[c] = v1 * w2 - v2 * w1, z[n + c] = v2 * w0 - v0 * w2, z[2 * n + c] = v0 * w1 - v1 * w0;
        prox[c] = f1 * u * v0 - f2 * s * w0;
        prox[n + c] = f1 * u * v1 - f2 * s * w1;
        prox[2 * n + c] = f1 * u * v2 - f2 * s * w2;
        prox[3 * n + c] = f1 * s * v0 + f2 * u * w0;
        prox[4 * n + c] = f1 * s * v1 + f2 * u * w1;
        prox[5 * n + c] = f1 * s * v2 + f2 * u * w2;
        norms += f1;
        // what `weigh` goes on from
        weight[c] = plus, weight[n + c] = minus, weight[2 * n + c] = s1;
        weight[3 * n + c] = product / s1;
    }
}

void ActiveBlocks::weigh(double t, Weighing weighing) {
    const long n = room;
    const bool resolvent = weighing == Weighing::resolvent;
    const double whole = resolvent ? MOST_WEIGHT : 1;
    // d = part / (part + rest)
    const auto weigh_one = [&](double part, double rest) {
        const double base = resolvent ? rest : part + rest;
        return base > 0 ? smaller(part / base, whole) : part > 0 ? whole : 0;
    };
    for (long c = 0; c < count; ++c) {
        const double plus = weight[c], minus = weight[n + c], s1 = weight[2 * n + c];
        const double s2 = weight[3 * n + c];
        const bool equal = minus <= t;
        const double f1 = equal ? larger(0.5 * (plus - t), 0) : s1 - t;
        const double f2 = equal ? f1 : s2;
        weight[c] = whole;
        weight[n + c] = weigh_one(larger(plus - t, 0), t);
        weight[2 * n + c] = weigh_one(f1, equal ? 0.5 * (minus + t) : t);
        weight[3 * n + c] = s2 > 0 ? weigh_one(f2, equal ? larger(0.5 * (t - minus), 0) : 0) : 0;
        weight[4 * n + c] = equal ? 0 : whole;
        weight[5 * n + c] = equal ? 0 : weigh_one(minus - t, t);
    }
}

long ActiveBlocks::write_rows(double sigma, LaidAtoms& atoms, const double* moved,
                              ShiftedGram& gram) const {
    const long q = gram.unknowns() / 2, stride = atoms.stride(), n = room;
    const long right = gram.right_side(), unknowns = gram.unknowns();
    long rows = 0;
    for (long c = 0; c < count; ++c) {
        const double* B = atoms.at(index[c]);
        const double u = cosine[c], s = sine[c];
        double scale[6];
        for (int r = 0; r < 6; ++r)
            scale[r] = root(sigma * weight[r * n + c]) * (r == 2 || r == 3 ? 1 : HALF_ROOT);
        double part[6] = {};
        if (moved) {
            const Turned X = turn(*this, moved, c);
            const double x[6] = {X.x[0] + X.x[4], X.x[1] - X.x[3], X.x[2],
                                 X.x[5],          X.x[0] - X.x[4], X.x[1] + X.x[3]};
            for (int r = 0; r < 6; ++r) part[r] = -scale[r] / sigma * x[r];
        }
        // row r is left[r] = (on e1, e2, e3 of the top row; the same of the low row)
        const double left[6][6] = {
            {u, -s, 0, s, u, 0}, {s, u, 0, -u, s, 0}, {0, 0, u, 0, 0, s},
            {0, 0, -s, 0, 0, u}, {u, s, 0, s, -u, 0}, {-s, u, 0, u, s, 0},
        };
        for (int r = 0; r < 6; ++r) {
            if (weight[r * n + c] == 0) continue;
            double* row = gram.row(rows++);
            // the row of F is top . B, low . B with top and low in the coordinates of B
            for (int half = 0; half < 2; ++half) {
                double* out = row + half * q;
                double t[3];
                for (int b = 0; b < 3; ++b)
                    t[b] = scale[r] * (left[r][3 * half] * v[b * n + c] +
                                       left[r][3 * half + 1] * w[b * n + c] +
                                       left[r][3 * half + 2] * z[b * n + c]);
                for (long j = 0; j < stride; j += WIDTH)
                    store(out + j, t[0] * load(B + j) + t[1] * load(B + stride + j) +
                                       t[2] * load(B + 2 * stride + j));
            }
            for (long j = unknowns; j < right; ++j) row[j] = 0;
            row[right] = part[r];
        }
    }
    return rows;
}

void ActiveBlocks::apply_weights(const double* X, double* out) const {
    const long n = room;
    for (long c = 0; c < count; ++c) {
        const Turned G = turn(*this, X, c);
        const double same = 0.5 * weight[c] * (G.x[0] + G.x[4]);
        const double skew = 0.5 * weight[n + c] * (G.x[1] - G.x[3]);
        const double differ = 0.5 * weight[4 * n + c] * (G.x[0] - G.x[4]);
        const double symmetric = 0.5 * weight[5 * n + c] * (G.x[1] + G.x[3]);
        const double z11 = same + differ, z22 = same - differ;
        const double z12 = symmetric + skew, z21 = symmetric - skew;
        const double z13 = weight[2 * n + c] * G.x[2], z23 = weight[3 * n + c] * G.x[5];
        const double u = cosine[c], s = sine[c];
        for (int b = 0; b < 3; ++b) {
            const double first = z11 * v[b * n + c] + z12 * w[b * n + c] + z13 * z[b * n + c];
            const double second = z21 * v[b * n + c] + z22 * w[b * n + c] + z23 * z[b * n + c];
            out[b * n + c] = u * first - s * second;
            out[(3 + b) * n + c] = s * first + u * second;
        }
    }
}

void ActiveBlocks::subtract_fit(LaidAtoms& atoms, double* y0, double* y1, long q) const {
    const long stride = atoms.stride(), n = room;
    for (long c = 0; c < count; ++c) {
        const double* B = atoms.at(index[c]);
        const double m0 = prox[c], m1 = prox[n + c], m2 = prox[2 * n + c];
        const double m3 = prox[3 * n + c], m4 = prox[4 * n + c], m5 = prox[5 * n + c];
        for (long j = 0; j < q; ++j) {
            const double b0 = B[j], b1 = B[stride + j], b2 = B[2 * stride + j];
            y0[j] -= m0 * b0 + m1 * b1 + m2 * b2;
            y1[j] -= m3 * b0 + m4 * b1 + m5 * b2;
        }
    }
}

}  // namespace shapefit::SHAPEFIT_LEVEL
