#include "pose.hpp"

#include "../algebra/scalar.hpp"
#include "rotation_step.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

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

}  // namespace shapefit::SHAPEFIT_LEVEL
