// The extension module shapefit.core._core.
#include "module.hpp"

#include "../algebra/views.hpp"
#include "../kernels.hpp"

NB_MODULE(_core, module) {
    nanobind::module_ parts = module.def_submodule("parts", "Single steps of the kernels, for tests.");
    module.attr("STRETCH") = shapefit::STRETCH;
    module.attr("LEVEL") = shapefit::level().name;
    const shapefit::Level* levels[4];
    nanobind::list names;
    for (int i = 0, count = shapefit::available_levels(levels, 4); i < count; ++i)
        names.append(levels[i]->name);
    module.attr("LEVELS") = nanobind::tuple(names);
    shapefit::bind_convex(module, parts);
    shapefit::bind_dictionary(module);
    shapefit::bind_algebra(parts);
    shapefit::bind_lifting(module, parts);
    shapefit::bind_outliers(module, parts);
    shapefit::bind_perspective(module, parts);
    shapefit::bind_posterior(module);
    shapefit::bind_pursuit(module, parts);
    shapefit::bind_rotation_search(module, parts);
    shapefit::bind_sequences(module);
}
