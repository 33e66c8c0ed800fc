// The extension module shapefit.core._core.
#include "bind.hpp"
#include "csv_rows.hpp"
#include "deflate.hpp"

NB_MODULE(_core, module) {
    using namespace shapefit;
    nb::module_ parts = module.def_submodule("parts", "Single steps of the kernels, for tests.");
    module.attr("STRETCH") = STRETCH;
    module.attr("LEVEL") = level().name;
    const Level* levels[4];
    nb::list names;
    for (int i = 0, count = available_levels(levels, 4); i < count; ++i)
        names.append(levels[i]->name);
    module.attr("LEVELS") = nb::tuple(names);

    const Kernels& kernel = level().kernels;
    define(module, "solve_convex", kernel.solve_convex);
    define(module, "certify", kernel.certify);
    define(module, "code", kernel.code);
    define(module, "find_objectives", kernel.find_objectives);
    define(module, "alternate", kernel.alternate);
    define(module, "combine", kernel.combine);
    define(module, "place", kernel.place);
    define(module, "find_pose", kernel.find_pose);
    define(module, "find_shape_moments", kernel.find_shape_moments);
    define(module, "turn_in_plane", kernel.turn_in_plane);
    define(module, "find_consensus", kernel.find_consensus);
    define(module, "find_posterior", kernel.find_posterior);
    define(module, "pursue", kernel.pursue);
    define(module, "reconstruct", kernel.reconstruct);
    define(module, "refine_perspective", kernel.refine_perspective);
    define(module, "synchronise", kernel.synchronise);
    define(module, "find_optimum", kernel.find_optimum);
    define(module, "find_modes", kernel.find_modes);
    define(module, "find_coefficients", kernel.find_coefficients);
    define(module, "find_precisions", kernel.find_precisions);
    define(module, "find_similarity_errors", kernel.find_similarity_errors);
    define(module, "find_camera_errors", kernel.find_camera_errors);
    define(module, "find_spread", kernel.find_spread);
    define(module, "smooth_sequence", kernel.smooth_sequence);
    define(module, "record_tree", kernel.record_tree);
    define(module, "add_products", kernel.add_products);
    define(module, "update_atoms", kernel.update_atoms);

    define(module, "deflate", deflate);
    define(module, "write_csv_rows", write_csv_rows);

    const Parts& part = level().parts;
    define(parts, "correlate", part.correlate);
    define(parts, "largest_nuclear_norm", part.largest_nuclear_norm);
    define(parts, "moreau", part.moreau);
    define(parts, "derivative", part.derivative);
    define(parts, "solve_gram", part.solve_gram);
    define(parts, "curvature", part.curvature);
    define(parts, "reduce", part.reduce);
    define(parts, "expand", part.expand);
    define(parts, "soft_squared", part.soft_squared);
    define(parts, "climb", part.climb);
    define(parts, "nearest_rotation", part.nearest_rotation);
    define(parts, "polar_rotation", part.polar_rotation);
    define(parts, "draw_triple", part.draw_triple);
    define(parts, "find_area", part.find_area);
    define(parts, "find_moments", part.find_moments);
    define(parts, "judge", part.judge);
    define(parts, "log_of_one_plus", part.log_of_one_plus);
    define(parts, "minimise_on_sphere", part.minimise_on_sphere);
    define(parts, "pose_triple", part.pose_triple);
    define(parts, "project_perspective", part.project_perspective);
    define(parts, "symmetric_eigen", part.symmetric_eigen);
    define(parts, "scaled_coefficients", part.scaled_coefficients);
    define(parts, "sparse_coefficients", part.sparse_coefficients);
    define(parts, "alternate_image", part.alternate_image);
    define(parts, "rotation_step", part.rotation_step);
    define(parts, "rotation_value", part.rotation_value);
    define(parts, "rotation_model", part.rotation_model);
    define(parts, "truncated_cg", part.truncated_cg);
    define(parts, "root_cells", part.root_cells);
    define(parts, "judge_cell", part.judge_cell);
    define(parts, "descend", part.descend);
    define(parts, "retract", part.retract);
    define(parts, "orthonormalise", part.orthonormalise);
}
