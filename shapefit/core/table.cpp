// The kernels of one instruction set, gathered in its table.
#include "kernels.hpp"
#include "algebra/logarithm.hpp"
#include "algebra/symmetric_eigen.hpp"
#include "convex/certificate.hpp"
#include "convex/parts.hpp"
#include "convex/stretch.hpp"
#include "dictionary/atom_update.hpp"
#include "dictionary/coding.hpp"
#include "lifting/alternation.hpp"
#include "lifting/placement.hpp"
#include "lifting/pose.hpp"
#include "lifting/reconstruction.hpp"
#include "lifting/rotation_step.hpp"
#include "lifting/scaled_coefficients.hpp"
#include "lifting/synchronisation.hpp"
#include "metrics/shape_errors.hpp"
#include "outliers/parts.hpp"
#include "perspective/projection.hpp"
#include "perspective/refinement.hpp"
#include "posterior/posterior.hpp"
#include "pursuit/pursuit.hpp"
#include "pursuit/sphere.hpp"
#include "rotation_search/modes.hpp"
#include "rotation_search/objective.hpp"
#include "rotation_search/optimum.hpp"
#include "rotation_search/parts.hpp"
#include "rotation_search/record.hpp"
#include "sequences/precisions.hpp"
#include "sequences/smoothing.hpp"

// The two steps by which a name becomes a string.
#define SHAPEFIT_QUOTE(name) #name
#define SHAPEFIT_NAME(name) SHAPEFIT_QUOTE(name)

namespace shapefit::SHAPEFIT_LEVEL {

extern const Level table;

const Level table = {
    .name = SHAPEFIT_NAME(SHAPEFIT_LEVEL),
    .kernels =
        {
            .solve_convex = solve_convex,
            .certify = certify_images,
            .code = code,
            .find_objectives = find_objectives,
            .alternate = alternate,
            .combine = combine,
            .place = place,
            .find_pose = find_pose,
            .find_shape_moments = find_shape_moments,
            .turn_in_plane = turn_in_plane,
            .find_consensus = find_consensus,
            .find_posterior = find_posterior,
            .pursue = pursue,
            .reconstruct = reconstruct,
            .refine_perspective = refine_perspective,
            .synchronise = synchronise,
            .find_optimum = find_optimum,
            .find_modes = find_modes,
            .find_coefficients = find_coefficients,
            .find_precisions = find_precisions,
            .find_similarity_errors = find_similarity_errors,
            .find_camera_errors = find_camera_errors,
            .find_spread = find_spread,
            .smooth_sequence = smooth_sequence,
            .record_tree = record_tree,
            .add_products = add_products,
            .update_atoms = update_atoms,
        },
    .parts =
        {
            .correlate = correlate_part,
            .largest_nuclear_norm = nuclear_part,
            .moreau = moreau_part,
            .derivative = derivative_part,
            .solve_gram = gram_part,
            .curvature = curvature_part,
            .reduce = reduce_part,
            .expand = expand_part,
            .soft_squared = soft_part,
            .climb = climb,
            .nearest_rotation = nearest_rotation,
            .polar_rotation = polar_rotation,
            .draw_triple = draw_candidates,
            .find_area = area_of,
            .find_moments = moments_of,
            .judge = gain_of,
            .log_of_one_plus = log_of_one_plus,
            .minimise_on_sphere = minimise_on_sphere_alone,
            .pose_triple = pose_triple,
            .project_perspective = project_alone,
            .symmetric_eigen = symmetric_eigen,
            .scaled_coefficients = solve_scaled,
            .sparse_coefficients = solve_lasso,
            .alternate_image = alternate_once,
            .rotation_step = take_rotation_step,
            .rotation_value = rotation_value,
            .rotation_model = rotation_model,
            .truncated_cg = trusted_step,
            .root_cells = root_cells,
            .judge_cell = judge_alone,
            .descend = descend_alone,
            .retract = retract_rotation,
            .orthonormalise = orthonormalise_rows,
        },
};

}  // namespace shapefit::SHAPEFIT_LEVEL
