// The pose of a known shape, argmin 1/2 ||w - s Rbar S||_F^2, from several starts.
#include "../base/registry.hpp"
#include "rotation_step.hpp"

namespace shapefit {

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, for each image.
struct PoseData {
    Arguments& from;
    Tensor<const double> shape_moments = from("shape_moments", "n 3 3");  // P = S S^T
    // D = w S^T
    Tensor<const double> landmarks_by_shape = from("landmarks_by_shape", "n 2 3");
    Blocks<const double> starts = from("starts", "n v 3 3");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<double> size = from("size", "n");  // s
};

// Write the rotation and size s of each image of the range: the best of the local
// minima from all its starts.
void find_pose(const PoseData& data, Range range) {
    for (Index image = range.first; image < range.last; ++image) {
        check_interrupt();
        const ShapeMoments moments{data.shape_moments[image].data,
                                   data.landmarks_by_shape[image].data, true};
        double least = INFINITE;
        for (Index start = 0; start < data.starts.size[1]; ++start) {
            Rotation R = Rotation::from(data.starts[image][start].data);
            const SquaredResidual residual = rotation_step(moments, R);
            if (!(residual.value < least)) continue;
            least = residual.value;
            data.size[image] = residual.scale;
            R.write(data.rotation[image].data);
        }
    }
}

const Exported<find_pose> find_pose_exported{"find_pose"};

}  // namespace shapefit
