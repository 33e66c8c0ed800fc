// The table of kernels that every instruction set fills, and the one that was chosen.
#pragma once

#include "convex/data.hpp"
#include "dictionary/data.hpp"
#include "lifting/data.hpp"
#include "metrics/data.hpp"
#include "outliers/data.hpp"
#include "perspective/data.hpp"
#include "posterior/data.hpp"
#include "pursuit/data.hpp"
#include "rotation_search/data.hpp"
#include "sequences/data.hpp"

namespace shapefit {

// A kernel works on a range of images of a batch; it writes their rows and no others.
struct Kernels {
    void (*solve_convex)(const ConvexTask&, Range);
    void (*certify)(const CertificateTask&, Range);
    void (*code)(const CodingData&, Range);
    void (*find_objectives)(const MisfitData&, Range);
    void (*alternate)(const AlternationData&, Range);
    void (*combine)(const CombinationData&, Range);
    void (*place)(const PlacementData&, Range);
    void (*find_pose)(const PoseData&, Range);
    void (*find_shape_moments)(const MomentsData&, Range);
    void (*turn_in_plane)(const ViewsData&, Range);
    void (*find_consensus)(const ConsensusData&, Range);
    void (*find_posterior)(const PosteriorData&, Range);
    void (*pursue)(const PursuitData&, Range);
    void (*reconstruct)(const ReconstructionData&, Range);
    void (*refine_perspective)(const PerspectiveData&, Range);
    void (*synchronise)(const SynchronisationData&, Range);
    void (*find_optimum)(const GlobalData&, Range);
    void (*find_modes)(const ModesData&, Range);
    void (*find_coefficients)(const CoefficientsData&, Range);
    void (*find_precisions)(const PrecisionData&, Range);
    void (*find_similarity_errors)(const SimilarityData&, Range);
    void (*find_camera_errors)(const CameraData&, Range);
    void (*find_spread)(const SpreadData&, Range);
    void (*smooth_sequence)(const SequenceData&);  // of one sequence
    TreeSize (*record_tree)(const TreeData&);  // of one image
    void (*add_products)(const ProductsData&);  // of all shapes, one after another
    void (*update_atoms)(const AtomUpdateData&);  // all at once
};

// Single steps of the kernels, for the tests that judge them one at a time.
struct Parts {
    void (*correlate)(Matrix<const double> Y, Tensor<const double> atoms, Matrix<double> N);
    double (*largest_nuclear_norm)(Matrix<const double> N);
    double (*moreau)(const MoreauData&);
    long (*derivative)(const DerivativeData&);
    void (*solve_gram)(const GramData&);
    void (*curvature)(Vector<const double> omega, Matrix<const double> curvature,
                      Matrix<double> rows, Matrix<double> matrix);
    long (*reduce)(Matrix<const double> X, Vector<const double> omega, Matrix<double> out);
    long (*expand)(Matrix<const double> y, Vector<const double> omega, Matrix<double> out);
    double (*soft_squared)(const SoftData&);
    double (*climb)(Tensor<const double> blocks, Matrix<double> R);
    void (*nearest_rotation)(Matrix<const double> A, Matrix<double> R);
    bool (*polar_rotation)(Matrix<const double> A, Matrix<double> R);
    void (*draw_triple)(Vector<const int64_t> candidates, Vector<uint64_t> state,
                        Vector<int64_t> triple);
    double (*find_area)(Matrix<const double> w, Vector<const int64_t> visible);
    void (*find_moments)(Matrix<const double> w, Vector<const double> squares,
                         Matrix<const double> S, Vector<const bool> inliers, Matrix<double> P,
                         Matrix<double> D, Vector<double> middle, Vector<double> origin);
    double (*judge)(Matrix<const double> w, Vector<const double> squares, Matrix<const double> S,
                    double size, Matrix<const double> R, Vector<const double> T, double threshold,
                    double area, bool lanes, Vector<bool> inliers);
    void (*log_of_one_plus)(Vector<const double> x, Vector<double> logarithm);
    double (*minimise_on_sphere)(Matrix<const double> G, Vector<const double> g, double radius,
                                 Vector<double> y);
    double (*pose_triple)(Matrix<const double> w, Matrix<const double> S,
                          Vector<const int64_t> triple, Tensor<double> R);
    void (*project_perspective)(const ProjectionData&);
    void (*symmetric_eigen)(Matrix<double> A, Vector<double> values, Matrix<double> V);
    void (*scaled_coefficients)(Matrix<const double> Q, Vector<const double> h,
                                Vector<const double> a, Vector<double> x);
    double (*sparse_coefficients)(Matrix<const double> w, Tensor<const double> atoms,
                                  Matrix<const double> R, double lam, bool is_signed,
                                  Vector<double> c);
    AlternationEnd (*alternate_image)(Matrix<const double> w, Tensor<const double> atoms, double lam,
                                      bool is_signed, double tolerance, Matrix<double> R,
                                      Vector<double> c, Vector<double> trace);
    Misfit (*rotation_step)(Matrix<const double> P, Matrix<const double> D, bool free_scale,
                            Matrix<double> R);
    double (*rotation_value)(Matrix<const double> P, Matrix<const double> D, bool free_scale,
                             Matrix<const double> R);
    Misfit (*rotation_model)(Matrix<const double> P, Matrix<const double> D, bool free_scale,
                             Matrix<const double> R, Vector<double> g, Matrix<double> H);
    TrustedStep (*truncated_cg)(Vector<const double> g, Matrix<const double> H, double radius,
                                Vector<double> step);
    void (*root_cells)(Matrix<double> vertices, Matrix<int64_t> cells);
    bool (*judge_cell)(const CellData&);
    double (*descend)(const DescentData&);
    void (*retract)(Matrix<const double> R, Vector<const double> step, Matrix<double> out);
    void (*orthonormalise)(Matrix<double> R);
};

struct Level {
    const char* name;
    Kernels kernels;
    Parts parts;
};

// Levels that this build has and this processor can run, best first; at least one.
int available_levels(const Level** levels, int room);

// The level in use: the best one, or what the environment variable SHAPEFIT_LEVEL names.
const Level& level();

}  // namespace shapefit
