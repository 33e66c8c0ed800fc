// Posterior moments of shapes in images of given views, for one Gaussian over shapes:
//
//     w_j = s P R x_j + t + noise_j,   noise_j ~ N(0, sigma^2 / omega_j^2 I),
//     x = mu + V z + d,   z ~ N(0, I),   d ~ N(0, rho I),   t anywhere.
//
// With u_j = 1 / (s^2 rho + sigma^2 / omega_j^2), A = s R V in the frame of the camera,
// B its first two axes with the translation as two more columns, and r = w - s P R mu:
//
//     M = prior + B^T u B = (T^T T)^-1,   z^ = M^-1 B^T u r,   e = r - B z^,
//     log p = -1/2 (r^T u e + log |M|) + ...,
//     R (x^ - mu) = A z^ / s + s rho P^T u e,
//     H_j = B_j M^-1 B_j^T,
//     cov R x = root root^T + ...,   root_j = (A_j / s - s rho P^T u_j B_j) T^T,
//
// the prior I for z and next to nothing for t. A view moves by D = s K_o R of s R, a
// turn K_o about an axis or 1 for log s:
//
//     d log p = <P D, sum_j u_j e_j x^_j^T - u_j B_j M^-1 V_j^T
//                            - s rho u_j (I - u_j H_j) P R>,
//     information = J^T u J - |T B^T u J|^2,   J_o = P D mu.
//
// A, B and T A are stored by columns: all x, all y and all depths, padded.
#include "../base/registry.hpp"
#include "../base/small_matrices.hpp"
#include "../base/vectors.hpp"

namespace shapefit {
namespace {

constexpr Index DIRECTIONS = 4;  // in which a view moves: three turns, and log s

// n images, their views, and the model.
struct ViewData {
    Arguments& from;
    Tensor<const double> residuals = from("residuals", "n 2 p");  // r
    // u, 0 for landmarks that do not count
    Matrix<const double> precisions = from("precisions", "n p");
    Tensor<const double> rotation = from("rotation", "n 3 3");
    Vector<const double> scale = from("scale", "n");
    Tensor<const double> modes = from("modes", "3 p q");  // V
    double translation_precision = from("translation_precision");
    Vector<double> log_density = from("log_density", "n");
};

// What else is expected of the images; arrays without elements are not wanted.
struct MomentData {
    Arguments& from;
    ViewData views{from};
    Matrix<const double> mean = from("mean", "3 p");
    double rest = from("rest");  // rho
    Tensor<double> shapes = from("shapes", "n 3 p");
    Matrix<double> translation = from("translation", "n 2");
    Tensor<double> left = from("left", "n 2 p");                  // e
    Blocks<double> uncertainty = from("uncertainty", "n p 2 2");  // H
    Matrix<double> gradient = from("gradient", "n 4?");
    Tensor<double> information = from("information", "n 4 4?");
    // sum of root root^T over the images of each block, in the frame of the shapes
    Tensor<double> covariance = from("covariance", "b 3p 3p?");
};

// out = factor sum_a r_a row_a for three rows of n numbers, `stride` apart.
void turn(const double* r, const double* rows, Index stride, double factor, Index n,
          double* __restrict out) {
    const double x = factor * r[0], y = factor * r[1], z = factor * r[2];
    const double *X = rows, *Y = rows + stride, *Z = rows + 2 * stride;
    for (Index i = 0; i < n; ++i) out[i] = x * X[i] + y * Y[i] + z * Z[i];
}

// An image under the model: what its log density takes.
struct Projection {
    Projection(const ViewData& data, Workspace& workspace)
        : data(data),
          p(data.modes.size[1]),
          q(data.modes.size[2]),
          width(padded(p)),
          columns(padded(q + 2)),
          r(workspace.matrix<double>(2, width)),
          u(workspace.vector<double>(width)),
          A(workspace.tensor<double>(columns, 3, width)),
          T(workspace.matrix<double>(columns, columns)),
          z(workspace.vector<double>(columns)),
          Az(workspace.matrix<double>(3, width)),
          e(workspace.matrix<double>(2, width)),
          ue(workspace.matrix<double>(2, width)),
          V_(workspace.tensor<double>(q, 3, width)),
          V_by_landmark_(workspace.tensor<double>(3, width, columns)),
          uB_(workspace.tensor<double>(columns, 2, width)),
          B_by_landmark_(workspace.tensor<double>(2, width, columns)),
          M_(workspace.zeros<double>(columns * columns)),
          white_(workspace.zeros<double>(columns)) {
        for (Index a = 0; a < 3; ++a)
            for (Index j = 0; j < p; ++j)
                for (Index k = 0; k < q; ++k)
                    V_[k][a][j] = V_by_landmark_[a][j][k] = data.modes[a][j][k];
    }

    // Project the model into an image; returns the log density.
    double project(Index image) {
        s = data.scale[image];
        R = data.rotation[image].data;
        for (Index j = 0; j < p; ++j) u[j] = data.precisions[image][j];
        for (Index c = 0; c < 2; ++c)
            for (Index j = 0; j < p; ++j) r[c][j] = data.residuals[image][c][j];
        project_modes();
        const double log_det = factorise();
        find_coefficients();
        return -0.5 * (dot_padded(r.data, ue.data, 2 * width) + log_det);
    }

    const ViewData& data;
    const Index p, q, width, columns;
    double s = 1;
    const double* R = nullptr;
    const Matrix<double> r;
    const Vector<double> u;
    const Tensor<double> A;
    const Matrix<double> T;
    const Vector<double> z;
    const Matrix<double> Az, e, ue;

  private:
    // A and u B, and B by landmarks.
    void project_modes() {
        for (Index k = 0; k < q; ++k)
            for (Index c = 0; c < 3; ++c)
                turn(R + 3 * c, V_[k].data, width, s, width, A[k][c].data);
        for (Index k = 0; k < q; ++k)
            for (Index c = 0; c < 2; ++c)
                for (Index j = 0; j < width; ++j) uB_[k][c][j] = u[j] * A[k][c][j];
        const Index plane = width * columns;
        for (Index c = 0; c < 2; ++c) {
            turn(R + 3 * c, V_by_landmark_.data, plane, s, plane,
                 B_by_landmark_[c].data);
            for (Index j = 0; j < p; ++j) {
                uB_[q + c][c][j] = u[j];
                B_by_landmark_[c][j][q + c] = 1;
            }
        }
    }

    // T by M = (T^T T)^-1; returns log |M|.
    double factorise() {
        for (Index i = 0; i < columns * columns; ++i) M_[i] = 0;
        for (Index k = 0; k < columns; ++k) M_[k * columns + k] = 1;
        for (Index k = q; k < q + 2; ++k)
            M_[k * columns + k] = data.translation_precision;
        add_product(1, plain(uB_.data, 2 * width), B_by_landmark_.data, M_, columns,
                    columns, columns, columns, upper(2 * width));
        return cholesky_inverse(M_, T.data, columns, columns);
    }

    // z^ = T^T T B^T u r, A z^, e and u e.
    void find_coefficients() {
        for (Index k = 0; k < columns; ++k)
            z[k] = dot_padded(uB_[k].data, r.data, 2 * width);
        for (Index k = 0; k < columns; ++k)
            white_[k] = dot_padded(T[k].data, z.data, columns);
        mix_rows(white_, columns, T.data, columns, columns, z.data);
        mix_rows(z.data, q, A.data, 3 * width, 3 * width, Az.data);
        for (Index c = 0; c < 2; ++c)
            for (Index j = 0; j < width; ++j) {
                e[c][j] = r[c][j] - Az[c][j] - z[q + c];
                ue[c][j] = u[j] * e[c][j];
            }
    }

    const Tensor<double> V_, V_by_landmark_, uB_, B_by_landmark_;
    double *M_, *white_;
};

// The moments of one image after another.
class Moments {
  public:
    Moments(const MomentData& data, Workspace& workspace)
        : data_(data),
          image_(data.views, workspace),
          p_(image_.p),
          q_(image_.q),
          width_(image_.width),
          columns_(image_.columns),
          mean_(workspace.matrix<double>(3, width_)),
          turned_mean_(workspace.matrix<double>(3, width_)),
          shape_(workspace.matrix<double>(3, width_)),
          TA_(workspace.tensor<double>(columns_, 3, width_)),
          TB_(workspace.tensor<double>(columns_, 2, width_)),
          across_(workspace.tensor<double>(2, 3, width_)),
          H_(workspace.tensor<double>(2, 2, width_)),
          J_(workspace.tensor<double>(DIRECTIONS, 2, width_)),
          uJ_(workspace.tensor<double>(DIRECTIONS, 2, width_)),
          root_(workspace.tensor<double>(columns_, 3, width_)),
          covariance_(workspace.matrix<double>(3 * width_, 3 * width_)) {
        for (Index a = 0; a < 3; ++a)
            for (Index j = 0; j < p_; ++j) mean_[a][j] = data.mean[a][j];
    }

    // Write what is expected of the images of a range.
    void write(Range range) {
        for (Index image = range.first; image < range.last; ++image) {
            check_interrupt();
            data_.views.log_density[image] = image_.project(image);
            find_shape();
            find_covariances();
            write_image(image);
            if (data_.gradient.size[0]) write_slopes(image);
            if (!data_.covariance.size[0]) continue;
            add_covariance();
            const bool ends = (image + 1) % IMAGES_PER_BLOCK == 0;
            if (ends || image + 1 == range.last)
                write_covariance(image / IMAGES_PER_BLOCK);
        }
    }

  private:
    // R mu, and R x^.
    void find_shape() {
        for (Index c = 0; c < 3; ++c) {
            turn(image_.R + 3 * c, mean_.data, width_, 1, width_, turned_mean_[c].data);
            for (Index j = 0; j < width_; ++j)
                shape_[c][j] = turned_mean_[c][j] + image_.Az[c][j] / image_.s;
        }
        const double factor = image_.s * data_.rest;
        for (Index c = 0; c < 2; ++c)
            for (Index j = 0; j < width_; ++j) shape_[c][j] += factor * image_.ue[c][j];
    }

    // T A^T and T B^T, B_j M^-1 A_j^T of each landmark, and H.
    void find_covariances() {
        const Index row = 3 * width_;
        for (Index i = 0; i < columns_ * row; ++i) TA_.data[i] = 0;
        add_product(1, plain(image_.T.data, columns_), image_.A.data, TA_.data,
                    columns_, row, row, row, up_to_row());
        for (Index k = 0; k < columns_; ++k)
            for (Index c = 0; c < 2; ++c)
                for (Index j = 0; j < width_; ++j)
                    TB_[k][c][j] = TA_[k][c][j] + image_.T[k][q_ + c];
        for (Index c = 0; c < 2; ++c)
            for (Index d = 0; d < 3; ++d) {
                double* __restrict sums = across_[c][d].data;
                for (Index j = 0; j < width_; ++j) sums[j] = 0;
                for (Index k = 0; k < q_ + 2; ++k) {
                    const double *b = TB_[k][c].data, *a = TA_[k][d].data;
                    for (Index j = 0; j < width_; ++j) sums[j] += b[j] * a[j];
                }
            }
        for (Index c = 0; c < 2; ++c)
            for (Index d = 0; d < 2; ++d)
                for (Index j = 0; j < width_; ++j)
                    H_[c][d][j] = across_[c][d][j] +
                                  TB_[q_][c][j] * image_.T[q_][q_ + d] +
                                  TB_[q_ + 1][c][j] * image_.T[q_ + 1][q_ + d];
    }

    // Write x^, t, e and H.
    void write_image(Index image) {
        const double* R = image_.R;
        for (Index a = 0; a < 3; ++a)
            for (Index j = 0; j < p_; ++j)
                data_.shapes[image][a][j] = R[a] * shape_[0][j] +
                                            R[3 + a] * shape_[1][j] +
                                            R[6 + a] * shape_[2][j];
        for (Index c = 0; c < 2; ++c) {
            data_.translation[image][c] = image_.z[q_ + c];
            for (Index j = 0; j < p_; ++j) {
                data_.left[image][c][j] = image_.e[c][j];
                for (Index d = 0; d < 2; ++d)
                    data_.uncertainty[image][j][c][d] = H_[c][d][j];
            }
        }
    }

    // Write the gradient and the information of the log density by the view.
    void write_slopes(Index image) {
        const double s = image_.s;
        double slope[2][3];  // by s P R, in the frame of the camera
        for (Index c = 0; c < 2; ++c)
            for (Index d = 0; d < 3; ++d) {
                slope[c][d] = dot_padded(image_.ue[c].data, shape_[d].data, width_) -
                              dot_padded(image_.u.data, across_[c][d].data, width_) / s;
                for (Index j = 0; d < 2 && j < p_; ++j)
                    slope[c][d] -= s * data_.rest * image_.u[j] *
                                   ((c == d) - image_.u[j] * H_[c][d][j]);
            }
        double* gradient = data_.gradient[image].data;
        gradient[0] = -s * slope[1][2];
        gradient[1] = s * slope[0][2];
        gradient[2] = s * (slope[1][0] - slope[0][1]);
        gradient[3] = s * (slope[0][0] + slope[1][1]);
        find_motions();
        write_information(data_.information[image]);
    }

    // J and u J.
    void find_motions() {
        for (Index j = 0; j < width_; ++j) {
            const double x = image_.s * turned_mean_[0][j];
            const double y = image_.s * turned_mean_[1][j];
            const double z = image_.s * turned_mean_[2][j];
            const double motions[DIRECTIONS][2] = {{0, -z}, {z, 0}, {-y, x}, {x, y}};
            for (Index o = 0; o < DIRECTIONS; ++o)
                for (Index c = 0; c < 2; ++c) {
                    J_[o][c][j] = motions[o][c];
                    uJ_[o][c][j] = image_.u[j] * motions[o][c];
                }
        }
    }

    // Write J^T u J - |T B^T u J|^2.
    void write_information(Matrix<double> information) {
        for (Index o = 0; o < DIRECTIONS; ++o)
            for (Index i = 0; i < DIRECTIONS; ++i)
                information[o][i] = dot_padded(J_[o].data, uJ_[i].data, 2 * width_);
        for (Index k = 0; k < q_ + 2; ++k) {
            double overlap[DIRECTIONS];
            for (Index o = 0; o < DIRECTIONS; ++o)
                overlap[o] = dot_padded(uJ_[o].data, TB_[k].data, 2 * width_);
            for (Index o = 0; o < DIRECTIONS; ++o)
                for (Index i = 0; i < DIRECTIONS; ++i)
                    information[o][i] -= overlap[o] * overlap[i];
        }
    }

    // Add root root^T, turned to the frame of the shapes.
    void add_covariance() {
        const double *R = image_.R, factor = image_.s * data_.rest;
        for (Index k = 0; k < q_ + 2; ++k)
            for (Index j = 0; j < width_; ++j) {
                const double inside = factor * image_.u[j];
                const double x = TA_[k][0][j] / image_.s - inside * TB_[k][0][j];
                const double y = TA_[k][1][j] / image_.s - inside * TB_[k][1][j];
                const double depth = TA_[k][2][j] / image_.s;
                for (Index a = 0; a < 3; ++a)
                    root_[k][a][j] = R[a] * x + R[3 + a] * y + R[6 + a] * depth;
            }
        const Index row = 3 * width_;
        add_product(1, transposed(root_.data, row), root_.data, covariance_.data, row,
                    row, row, row, upper(q_ + 2));
    }

    // Write the covariance of a block, and begin with the next.
    void write_covariance(Index block) {
        mirror(covariance_.data, 3 * width_, 3 * width_);
        for (Index a = 0; a < 3; ++a)
            for (Index i = 0; i < p_; ++i)
                for (Index b = 0; b < 3; ++b)
                    for (Index j = 0; j < p_; ++j)
                        data_.covariance[block][a * p_ + i][b * p_ + j] =
                            covariance_[a * width_ + i][b * width_ + j];
        for (Index i = 0; i < 9 * width_ * width_; ++i) covariance_.data[i] = 0;
    }

    const MomentData& data_;
    Projection image_;
    const Index p_, q_, width_, columns_;
    const Matrix<double> mean_, turned_mean_, shape_;
    const Tensor<double> TA_, TB_, across_, H_, J_, uJ_, root_;
    const Matrix<double> covariance_;
};

// Write the log densities of the images of the range.
void find_view_densities(const ViewData& data, Range range) {
    Workspace workspace;
    Projection projection(data, workspace);
    for (Index image = range.first; image < range.last; ++image) {
        check_interrupt();
        data.log_density[image] = projection.project(image);
    }
}

// Write the moments of the images of the range.
void expect_shapes(const MomentData& data, Range range) {
    Workspace workspace;
    Moments(data, workspace).write(range);
}

const Exported<find_view_densities> find_view_densities_exported{"find_view_densities"};
const Exported<expect_shapes> expect_shapes_exported{"expect_shapes"};

}  // namespace
}  // namespace shapefit
