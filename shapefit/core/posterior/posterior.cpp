// The posterior over shape and view of each image, by Laplace's method at each mode m:
//
//     p(w) ~ sum_m pi_m exp(L_m) |H_m + I|^-1/2,
//     y | w ~ sum_m share_m N(mean_m, C_m),
//
// with L_m and H_m the log likelihood and the Hessian of -L there, mean_m and C_m of
// description.hpp; and the mean and covariance of this mixture.
#include "../base/small_matrices.hpp"
#include "description.hpp"
#include "limbs.hpp"

namespace shapefit {
namespace {

constexpr double SAME_VIEW = 1e-2;  // rotations as close are one mode (Frobenius norm)
// Subtracted from the log evidence of a point that is no maximum.
constexpr double NO_MAXIMUM = 50;
// Modes this far below the best in log evidence are left out.
constexpr double NEGLIGIBLE = 6;
// By which integrating over the view may change their order.
constexpr double LAPLACE = 1;
constexpr int MIXED[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // coordinates of a landmark

// A mode of the posterior of an image.
struct Mode {
    Origin origin;
    Index component;
    Rotation R;
    double log_scale;
    double log_evidence;
    double squared_mahalanobis;
    bool stationary;           // the gradient is 0, and every direction leads down
    double root[VIEW * VIEW];  // W with W^T W = (H + I)^-1, the covariance of the view
    double* inlier_probability;  // (m,)
    double share;                // of the evidence of its image
    double* mean;                // (3 p,)
};

// The modes of the images of a group; `order` has those that count, image by image, the
// best first.
struct Modes {
    Modes(Workspace& workspace, Index most, Index p)
        : modes(workspace.zeros<Mode>(most)), order(workspace.zeros<Index>(most)) {
        for (Index i = 0; i < most; ++i) {
            modes[i].inlier_probability = workspace.zeros<double>(p);
            modes[i].mean = workspace.zeros<double>(3 * p);
        }
    }

    Mode& operator[](Index i) const { return modes[order[i]]; }

    Mode* modes;
    Index* order;
    Index count = 0;  // of order
};

// Set `mode` to the point at which ascent i ended, with its evidence by Laplace's
// method, where negative eigenvalues of the Hessian count as 0.
void set_mode(const PosteriorData& data, const Search& search, Index i, Mode& mode) {
    Ascent<Doubles>& at = search.finished[i];
    const Index lane = i % WIDTH;
    double H[VIEW * VIEW], values[VIEW], axes[VIEW * VIEW], log_det = 0;  // of H + I
    for (int e = 0; e < VIEW * VIEW; ++e) H[e] = at.curvature[e][lane];
    symmetric_eigen({H, {VIEW, VIEW}}, {values, {VIEW}}, {axes, {VIEW, VIEW}});
    for (int e = 0; e < VIEW * VIEW; ++e)
        mode.root[e] =
            axes[e] / root(larger(values[e / VIEW], 0.0) + CURVATURE_OF_PRIOR);
    for (double value : values) log_det += log(larger(value, 0.0) + CURVATURE_OF_PRIOR);
    mode.stationary = values[0] > 1e-6 && !(at.moving[lane] > 0);
    mode.origin = search.finished.origin[i];
    mode.component = mode.origin.pair % data.means.size[0];
    for (int e = 0; e < 9; ++e) mode.R[e] = at.view.R[e][lane];
    mode.log_scale = at.view.log_scale[lane];
    for (Index j = 0; j < search.group.m; ++j)
        mode.inlier_probability[j] = at.inlier_probability[j][lane];
    mode.squared_mahalanobis = at.found.squared_mahalanobis[lane];
    mode.log_evidence = at.found.value[lane] + data.log_weights[mode.component] +
                        0.5 * (VIEW * LOG_TWO_PI - log_det);
    // A saddle, or a point on the way, counts only where no ascent ends on a maximum.
    if (!mode.stationary) mode.log_evidence -= NO_MAXIMUM;
}

// Sort the modes of the image at `slot`, among the first `count` of all, by evidence,
// the largest first, and append them to the order; those that are negligible, or the
// same as one before, are left out.
void append_sorted(Modes& all, Index count, Index slot) {
    const Index first = all.count;
    Index *order = all.order + first, found = 0, retained = 0;
    for (Index i = 0; i < count; ++i) {
        if (all.modes[i].origin.slot != slot) continue;
        Index place = found++;
        for (; place > 0 &&
               all.modes[order[place - 1]].log_evidence < all.modes[i].log_evidence;
             --place)
            order[place] = order[place - 1];
        order[place] = i;
    }
    for (Index i = 0; i < found; ++i) {
        const Mode& mode = all.modes[order[i]];
        if (mode.log_evidence < all.modes[order[0]].log_evidence - NEGLIGIBLE) break;
        bool known = false;
        for (Index o = 0; o < retained && !known; ++o) {
            const Mode& other = all.modes[order[o]];
            double distance = 0;
            for (int e = 0; e < 9; ++e) distance += square(mode.R[e] - other.R[e]);
            known =
                other.component == mode.component && distance < SAME_VIEW * SAME_VIEW;
        }
        if (!known) order[retained++] = order[i];
    }
    all.count += retained;
}

// x_e = value for n numbers.
void fill(double* x, Index n, double value) {
    for (Index e = 0; e < n; ++e) x[e] = value;
}

// Mean and covariance of the mixture of an image, C = sum_i share_i (C_i + (mean_i -
// mean) (mean_i - mean)^T): deviations and MIXED correlations, and the whole covariance
// where there is room for it.
struct Mixture {
    Mixture(const PosteriorData& data, Index image)
        : p(data.landmarks.size[2]),
          d(3 * p),
          mean(data.mean[image].data),
          squares(data.deviation[image].data),
          mixed(data.correlation[image].data),
          whole(data.covariance.size[0] ? data.covariance[image].data : nullptr) {}

    // Whether mixtures are wanted.
    static bool is_wanted(const PosteriorData& data) { return data.mean.size[0] > 0; }

    // Set mean, covariances and correlations to one value.
    void set_all(double value) {
        fill(mean, d, value);
        fill(squares, d, value);
        fill(mixed, d, value);
        if (whole) fill(whole, d * d, value);
    }

    // C_ef += of(e, f) for the entries e >= f that are stored.
    template <class Of>
    void add(const Of& of) {
        for (Index e = 0; !whole && e < d; ++e) squares[e] += of(e, e);
        for (Index e = 0; !whole && e < d; ++e) mixed[e] += of(second(e), first(e));
        for (Index e = 0; whole && e < d; ++e)
            for (Index f = 0; f <= e; ++f) whole[e * d + f] += of(e, f);
    }

    // Multiply mean and covariances by a factor.
    void multiply(double factor) {
        for (Index e = 0; e < d; ++e) {
            mean[e] *= factor;
            squares[e] *= factor;
            mixed[e] *= factor;
        }
        for (Index e = 0; whole && e < d * d; ++e) whole[e] *= factor;
    }

    // Turn variances into deviations, and the MIXED covariances into correlations.
    void finish() {
        for (Index e = 0; whole && e < d; ++e) {
            squares[e] = whole[e * d + e];
            mixed[e] = whole[second(e) * d + first(e)];
            for (Index f = 0; f < e; ++f) whole[f * d + e] = whole[e * d + f];
        }
        for (Index e = 0; e < d; ++e) squares[e] = root(larger(squares[e], 0.0));
        for (Index e = 0; e < d; ++e)
            mixed[e] /= larger(squares[first(e)] * squares[second(e)], TINY);
    }

    // The two coordinates whose correlation is number e of the MIXED ones.
    Index first(Index e) const { return MIXED[e / p][0] * p + e % p; }
    Index second(Index e) const { return MIXED[e / p][1] * p + e % p; }

    const Index p, d;
    double *mean, *squares, *mixed, *whole;
};

// Set all outputs of an image to nan, as no posterior was found.
void set_failed(const PosteriorData& data, Index image) {
    if (Mixture::is_wanted(data)) Mixture(data, image).set_all(NOT_A_NUMBER);
    fill(data.inlier_probability[image].data, data.landmarks.size[2], NOT_A_NUMBER);
    fill(data.rotation[image].data, 9, NOT_A_NUMBER);
    data.scale[image] = data.log_evidence[image] = data.squared_mahalanobis[image] =
        NOT_A_NUMBER;
    data.stationary[image] = false;
}

// Write the modes of a description, which are those from `first` on, as those of their
// rank in their image: the first of them has the rank `rank`.
void store(const PosteriorData& data, const Group& group, const Modes& modes,
           Index first, Index rank, const Description& description) {
    const Index p = data.landmarks.size[2], d = 3 * p,
                most_stored = data.mode_component.size[1];
    for (Index i = first; i < modes.count && i < first + WIDTH; ++i, ++rank) {
        const Mode& mode = modes[i];
        const Index lane = i - first, image = group.image[mode.origin.slot];
        if (i > first && mode.origin.slot != modes[i - 1].origin.slot) rank = 0;
        if (rank >= most_stored) continue;
        data.mode_component[image][rank] = mode.component;
        data.mode_scale[image][rank] = exp(mode.log_scale);
        data.mode_log_evidence[image][rank] = mode.log_evidence;
        mode.R.write(data.mode_rotation[image][rank].data);
        for (Index e = 0; e < d; ++e) {
            data.mode_mean[image][rank].data[e] = description.mean_of(e)[lane];
            for (Index f = 0; f < d; ++f)
                data.mode_covariance[image][rank][e][f] =
                    description.covariance_of(e, f)[lane];
        }
        const Vector<double> inlier_probability =
            data.mode_inlier_probability[image][rank];
        fill(inlier_probability.data, p, NOT_A_NUMBER);
        for (Index j = 0; j < group.m; ++j)
            inlier_probability[group.index[j]] = mode.inlier_probability[j];
    }
}

// Set the shares of the modes of an image, all from `first` on, and write the outputs
// that follow from them. The mean and covariance of the mixture, which are summed
// later, become 0.
void write_shares(const PosteriorData& data, const Group& group, const Modes& modes,
                  Index first) {
    const Index image = group.image[modes[first].origin.slot], last = modes.count;
    const double best = modes[first].log_evidence;
    double total = 0;
    for (Index i = first; i < last; ++i)
        total += modes[i].share = exp(modes[i].log_evidence - best);
    const Vector<double> inlier_probability = data.inlier_probability[image];
    fill(inlier_probability.data, inlier_probability.size[0], NOT_A_NUMBER);
    for (Index j = 0; j < group.m; ++j) inlier_probability[group.index[j]] = 0;
    data.squared_mahalanobis[image] = 0;
    for (Index i = first; i < last; ++i) {
        const double share = modes[i].share /= total;
        data.squared_mahalanobis[image] += share * modes[i].squared_mahalanobis;
        for (Index j = 0; j < group.m; ++j)
            inlier_probability[group.index[j]] +=
                share * modes[i].inlier_probability[j];
    }
    if (Mixture::is_wanted(data)) Mixture(data, image).set_all(0);
    modes[first].R.write(data.rotation[image].data);
    data.scale[image] = exp(modes[first].log_scale);
    data.log_evidence[image] = best + log(total);
    data.stationary[image] = modes[first].stationary;
}

// Set `description` to mean and covariance of the WIDTH modes from `first` on, one a
// lane; lanes that are left over repeat the last mode. The covariance is `whole`, or
// only the block (3, 3) of each landmark.
void describe_modes(const PosteriorData& data, const Group& group, const Modes& modes,
                    Index first, bool whole, LaneWorkspace<Doubles>& lanes,
                    Description& description) {
    check_interrupt();
    LaneView<Doubles> view;
    Doubles root_of[VIEW * VIEW];
    Origin origin[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane) {
        const Mode& mode =
            modes[first + lane < modes.count ? first + lane : modes.count - 1];
        origin[lane] = mode.origin;
        for (int e = 0; e < 9; ++e) view.R[e][lane] = mode.R[e];
        view.log_scale[lane] = mode.log_scale;
        for (int e = 0; e < VIEW * VIEW; ++e) root_of[e][lane] = mode.root[e];
        for (Index j = 0; j < group.m; ++j)
            lanes.space.inlier_probability[j][lane] = mode.inlier_probability[j];
    }
    gather(data, group, origin, lanes);
    describe(data, lanes, view, lanes.space.inlier_probability, root_of, whole,
             description);
}

// A mixture whose shares are multiplied by exp(least - lost): `lost` is by how much the
// lengths of limbs lower the log evidence of a mode, `least` the least of these.
struct Reweighed {
    // Add a mode with the covariance C(e, f) to the mixture, after the modes of its
    // image from `first` on.
    template <class Covariance>
    void add(const Modes& modes, Index first, Index mode, double lost,
             const Covariance& C) {
        if (mode == first || lost < least) {
            const double factor = mode == first ? 0 : exp(lost - least);
            mixture.multiply(factor);
            for (Index i = first; i < mode; ++i) modes[i].share *= factor;
            least = lost;
        }
        const double share = modes[mode].share *= exp(least - lost);
        mixture.add([&](Index e, Index f) { return share * C(e, f); });
    }

    // Scale the shares to a sum of 1, and write what follows from them for the image.
    void finish(const PosteriorData& data, const Modes& modes, Index first, Index last,
                Index image) {
        double total = 0;
        Index best = first;
        for (Index i = first; i <= last; ++i) {
            total += modes[i].share;
            if (modes[i].share > modes[best].share) best = i;
        }
        for (Index i = first; i <= last; ++i) modes[i].share /= total;
        mixture.multiply(1 / total);
        data.log_evidence[image] += log(total) - least;
        data.scale[image] = exp(modes[best].log_scale);
        modes[best].R.write(data.rotation[image].data);
    }

    Mixture& mixture;
    double& least;
};

// Write mean and covariance of each image of a group: those of the mixture of its
// modes. Where lengths of limbs are known, each mode is conditioned on them first, and
// its share changes; modes that are stored one by one are not conditioned. lanes and
// description are scratch memory.
void write_mixtures(const PosteriorData& data, const Group& group, const Modes& modes,
                    LaneWorkspace<Doubles>& lanes, Description& description,
                    LimbLengths& limbs) {
    const Index d = 3 * data.landmarks.size[2];
    const bool stored = data.mode_component.size[1] > 0;
    const auto image_of = [&](Index i) { return group.image[modes[i].origin.slot]; };
    Doubles lost = {};
    double least_lost = 0;
    for (Index i = 0, rank = 0; i < modes.count; ++i) {
        Mode& mode = modes[i];
        const Index lane = i % WIDTH, image = image_of(i);
        Mixture mixture(data, image);
        if (lane == 0) {
            const bool whole = mixture.whole || stored || limbs.are_known();
            describe_modes(data, group, modes, i, whole, lanes, description);
            if (stored) store(data, group, modes, i, rank, description);
            if (limbs.are_known()) lost = limbs.condition(description);
        }
        for (Index e = 0; e < d; ++e) mode.mean[e] = description.mean_of(e)[lane];
        const auto C = [&](Index e, Index f) {
            return description.covariance_of(e, f)[lane];
        };
        if (limbs.are_known())
            Reweighed{mixture, least_lost}.add(modes, i - rank, i, lost[lane], C);
        else mixture.add([&](Index e, Index f) { return mode.share * C(e, f); });
        for (Index e = 0; e < d; ++e) mixture.mean[e] += mode.share * mode.mean[e];
        ++rank;
        if (i + 1 < modes.count && image_of(i + 1) == image) continue;
        if (limbs.are_known())
            Reweighed{mixture, least_lost}.finish(data, modes, i + 1 - rank, i, image);
        for (; rank; --rank) {
            const Mode& of = modes[i + 1 - rank];
            mixture.add([&](Index e, Index f) {
                return of.share * (of.mean[e] - mixture.mean[e]) *
                       (of.mean[f] - mixture.mean[f]);
            });
        }
        mixture.finish();
    }
}

// Write the posteriors of the images of the group of `search`, all in double precision
// where `precise`. modes and description are scratch memory.
void find_group(const PosteriorData& data, bool precise, Search& search, Modes& modes,
                Description& description, LimbLengths& limbs) {
    Group& group = search.group;
    ascend_all(data, NEGLIGIBLE + LAPLACE, precise, search);
    for (Index i = 0; i < search.finished.count; ++i)
        set_mode(data, search, i, modes.modes[i]);
    modes.count = 0;
    for (Index slot = 0; slot < group.count; ++slot) {
        const Index before = modes.count;
        if (precise || !group.failed[slot])
            append_sorted(modes, search.finished.count, slot);
        if (modes.count > before) write_shares(data, group, modes, before);
        else set_failed(data, group.image[slot]);
    }
    if (Mixture::is_wanted(data))
        write_mixtures(data, group, modes, search.double_precision, description, limbs);
}

}  // namespace

// Write the posterior of each image of the range: ascend from every start under every
// component, weigh the maxima by their evidence, the view integrated out by Laplace's
// approximation, and take mean and covariance of the mixture of those that count.
void find_posterior(const PosteriorData& data, Range range) {
    const Index p = data.landmarks.size[2];
    Workspace workspace;
    Search search(workspace, data);
    Group& group = search.group;
    Description description(workspace, p);
    Modes modes(workspace, group.capacity * ascents_per_image(data), p);
    LimbLengths limbs(workspace, data);
    for (Index image = range.first; image < range.last; ++image) {
        data.rounds[image] = 0;
        for (Index i = 0; i < data.mode_component.size[1]; ++i) {
            data.mode_component[image][i] = -1;
            data.mode_log_evidence[image][i] = -INFINITE;
        }
    }
    for (Index first = range.first; first < range.last; first += IMAGES_PER_BLOCK) {
        const Range block{first, first + IMAGES_PER_BLOCK < range.last
                                     ? first + IMAGES_PER_BLOCK
                                     : range.last};
        bool taken[IMAGES_PER_BLOCK] = {};
        for (group.collect(data, block, taken); group.count;
             group.collect(data, block, taken)) {
            find_group(data, false, search, modes, description, limbs);
            group.retain_failed();
            find_group(data, true, search, modes, description, limbs);
        }
    }
}

const Exported<find_posterior> find_posterior_exported{"find_posterior"};

}  // namespace shapefit
