// The files of the extension module, one per subject.
#pragma once

#include <nanobind/nanobind.h>

namespace shapefit {

void bind_convex(nanobind::module_& module, nanobind::module_& parts);
void bind_dictionary(nanobind::module_& module);
void bind_algebra(nanobind::module_& parts);
void bind_lifting(nanobind::module_& module, nanobind::module_& parts);
void bind_outliers(nanobind::module_& module, nanobind::module_& parts);
void bind_perspective(nanobind::module_& module, nanobind::module_& parts);
void bind_posterior(nanobind::module_& module);
void bind_pursuit(nanobind::module_& module, nanobind::module_& parts);
void bind_rotation_search(nanobind::module_& module, nanobind::module_& parts);
void bind_sequences(nanobind::module_& module);

}  // namespace shapefit
