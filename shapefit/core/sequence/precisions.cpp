#include "precisions.hpp"

#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "../base/workspace.hpp"
#include "../base/triangles.hpp"

namespace shapefit {

void find_precisions(const PrecisionData& data, Range range) {
    const long K = data.there.size[1], d = data.matrices.size[2], D = padded(d);
    Workspace workspace;
    double *S = workspace.zeros<double>(D * D), *V = workspace.zeros<double>(D * D);
    for (long image = range.first; image < range.last; ++image)
        for (long k = 0; k < K; ++k) {
            if (!data.there[image][k]) continue;
            double *C = data.matrices[image][k].data, factor = data.factor[image][k];
            for (long i = 0; i < D; ++i)
                for (long j = 0; j < D; ++j)
                    S[i * D + j] = i >= d || j >= d ? (i == j ? 1.0 : 0.0)
                                   : factor > 0     ? factor * C[i * d + j]
                                                    : 0.0;
            for (long i = 0; i < d; ++i) S[i * D + i] += data.more[image][k];
            data.log_det[image][k] = factorise_block(S, V, D, D);
            multiply_out(V, S, D, D);
            mirror(S, D, D);
            for (long i = 0; i < d; ++i)
                for (long j = 0; j < d; ++j) C[i * d + j] = S[i * D + j];
        }
}

const Exported<find_precisions> find_precisions_exported{"find_precisions"};

}  // namespace shapefit
