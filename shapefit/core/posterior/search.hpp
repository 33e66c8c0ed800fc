// The modes of the posterior of images: the maxima of L(theta) + log pi_k from every
// start R under every component k of the mixture, L the log likelihood of
// likelihood.hpp.
//
// Ascents run side by side, one a lane. Those that have finished are taken out, so that
// blocks of lanes stay full; no lane knows of its neighbours.
#pragma once

#include "ascent.hpp"

namespace shapefit {

constexpr Index MAX_ASCENTS = 512;   // of a group of more than one image
constexpr Index ROUNDS_AT_ONCE = 2;  // after which finished ascents are taken out
// Rounds in single precision; what takes longer starts again in double.
constexpr Index MAX_SINGLE_ROUNDS = 16;
constexpr Index MAX_ROUNDS = 200;  // in double
// Difference of single and double precision at the end, in log likelihood, from which
// on the former has failed.
constexpr double MAX_DISAGREEMENT = 1;
constexpr double MAX_GROWTH = 100;  // of the scale, over that of the start
// An ascent may still gain this many times the predicted gain.
constexpr double GAIN_FACTOR = 2;

// The number of ascents of an image: starts times components.
constexpr Index ascents_per_image(const PosteriorData& data) {
    return data.starts.size[1] * data.means.size[0];
}

// Images of a block that have the same landmarks in sight.
struct Group {
    Group(Workspace& workspace, const PosteriorData& data)
        : capacity(capacity_of(data)),
          image(workspace.zeros<Index>(capacity)),
          index(workspace.zeros<Index>(data.means.size[2])),
          best(workspace.zeros<double>(capacity)),
          failed(workspace.zeros<bool>(capacity)) {}

    // The largest number of images in a group: those of MAX_ASCENTS ascents together,
    // at least 1 and at most IMAGES_PER_BLOCK.
    static Index capacity_of(const PosteriorData& data) {
        const Index images = MAX_ASCENTS / ascents_per_image(data);
        return images < 1 ? 1 : images < IMAGES_PER_BLOCK ? images : IMAGES_PER_BLOCK;
    }

    // Fill the group with the first image of a range that is not yet `taken` and with
    // those that have the same visible landmarks; it is empty where all are taken.
    void collect(const PosteriorData& data, Range range, bool* taken) {
        const auto sees = [&](Index i, Index j) {
            return is_finite(data.residual_variance[i][j]);
        };
        const Index p = data.means.size[2];
        count = m = 0;
        for (Index i = range.first; i < range.last && count < capacity; ++i) {
            Index alike = taken[i - range.first] ? -1 : 0;
            while (count && alike >= 0 && alike < p &&
                   sees(i, alike) == sees(image[0], alike))
                ++alike;
            if (alike < (count ? p : 0)) continue;
            taken[i - range.first] = true;
            image[count++] = i;
        }
        for (Index j = 0; count && j < p; ++j)
            if (sees(image[0], j)) index[m++] = j;
    }

    // Drop the images for which single precision has not failed.
    void retain_failed() {
        const Index before = count;
        count = 0;
        for (Index i = 0; i < before; ++i)
            if (failed[i]) image[count++] = image[i];
    }

    const Index capacity;
    Index count = 0, m = 0;
    Index* image;  // (count,)
    Index* index;  // the landmarks in sight (m,)
    double* best;  // of each image, in log likelihood and weight (count,)
    bool* failed;  // whether single precision has (count,)
};

// The image of a lane, by its place in the group, its start and component as K start +
// component.
struct Origin {
    Index slot, pair;
};

// A list of ascents, in blocks of one a lane.
template <class Lanes>
struct Ascents {
    Ascents(Workspace& workspace, Index most, Index p)
        : p(p),
          origin(workspace.zeros<Origin>(most + width<Lanes>)),
          lanes(workspace.zeros<Ascent<Lanes>>((most + width<Lanes> - 1) /
                                               width<Lanes>)) {
        for (Index b = 0; b * width<Lanes> < most; ++b) {
            lanes[b].inlier_probability = workspace.zeros<Lanes>(p);
            lanes[b].next = workspace.zeros<Lanes>(p);
        }
    }

    // The ascents of block b, one a lane.
    Ascent<Lanes>& block(Index b) const { return lanes[b]; }
    // The block that holds ascent i, in lane i % width.
    Ascent<Lanes>& operator[](Index i) const { return block(i / width<Lanes>); }
    // The number of blocks.
    Index blocks() const { return (count + width<Lanes> - 1) / width<Lanes>; }
    // Append a copy of ascent i of a list, which may be this one; its ascents stay in
    // memory behind its end.
    template <class Others>
    void append(const Ascents<Others>& from, Index i) {
        const Index to_lane = count % width<Lanes>, lane = i % width<Others>;
        each_pair((*this)[count], from[i], p, [=](Lanes& to, const Others& given) {
            to[to_lane] = static_cast<Number<Lanes>>(given[lane]);
        });
        origin[count++] = from.origin[i];
    }
    // Fill the last block with copies of ascents, without counting them.
    void pad() {
        const Index own = count;
        while (count % width<Lanes>) append(*this, count - own % width<Lanes>);
        count = own;
    }

    const Index p;
    Index count = 0;
    Origin* origin;
    Ascent<Lanes>* lanes;
};

// The images and ascents of the lanes of one precision, and their memory.
template <class Lanes>
struct LaneWorkspace {
    LaneWorkspace(Workspace& workspace, const PosteriorData& data, Index ascents)
        : observed(workspace, data.means.size[2]),
          space(workspace, data.means.size[2]),
          ascents(workspace, ascents, data.means.size[2]) {}

    Observed<Lanes> observed;
    Index component[width<Lanes>];  // of each lane, -1 where none stands there
    AscentSpace<Lanes> space;
    Ascents<Lanes> ascents;
};

// The ascents of a group. They begin in single precision; their end, and those that
// take long, are in double, as is everything where single precision fails.
struct Search {
    // Room for all ascents of the images that are lifted together.
    Search(Workspace& workspace, const PosteriorData& data)
        : group(workspace, data),
          single_precision(workspace, data, group.capacity * ascents_per_image(data)),
          double_precision(workspace, data, group.capacity * ascents_per_image(data)),
          finished(workspace, group.capacity * ascents_per_image(data),
                   data.means.size[2]) {}

    Group group;
    LaneWorkspace<Singles> single_precision;
    LaneWorkspace<Doubles> double_precision;
    Ascents<Doubles> finished;
};

// Copy the visible landmarks of the image and of the component of each lane of a block
// to `lanes.observed`; origin (width,) are those of its ascents.
template <class Lanes>
void gather(const PosteriorData& data, const Group& group, const Origin* origin,
            LaneWorkspace<Lanes>& lanes) {
    Observed<Lanes>& to = lanes.observed;
    const Index p = data.means.size[2], m = group.m, *index = group.index;
    Index image[width<Lanes>];
    bool known = true;
    for (int lane = 0; lane < width<Lanes>; ++lane) {
        const Index k = origin[lane].pair % data.means.size[0];
        image[lane] = group.image[origin[lane].slot];
        known = known && lanes.component[lane] == k;
        lanes.component[lane] = k;
    }
    const auto fill = [](Lanes& to, const auto& of) {
        for (int lane = 0; lane < width<Lanes>; ++lane)
            to[lane] = static_cast<Number<Lanes>>(of(lane));
    };
    to.m = m;
    to.index = index;
    for (Index e = 0; e < m; ++e) {
        const Index j = index[e];
        for (int a = 0; a < 2; ++a) {
            fill(to.w[2 * e + a],
                 [&](int lane) { return data.landmarks[image[lane]][a][j]; });
            fill(to.slope[2 * e + a],
                 [&](int lane) { return data.slopes[image[lane]][a][j]; });
        }
        fill(to.residual_variance[e],
             [&](int lane) { return data.residual_variance[image[lane]][j]; });
        for (int c = 0; c < 3; ++c)
            fill(to.noise[3 * e + c], [&](int lane) {
                return data.noise[image[lane]][j].data[c == 2 ? 3 : c];
            });
    }
    for (Index e = 0; !known && e < 3 * m; ++e)
        fill(to.mean[e], [&](int lane) {
            return data.means[lanes.component[lane]][e % 3][index[e / 3]];
        });
    for (Index e = 0; !known && e < m; ++e)
        for (Index f = 0; f <= e; ++f)
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b)
                    fill(to.covariance[9 * (corner(e) + f) + 3 * a + b], [&](int lane) {
                        return data.covariances[lanes.component[lane]][a * p + index[e]]
                                               [b * p + index[f]];
                    });
}

// The scale s at which s A mu + t fits the landmarks of an image best, for a rotation R
// and component k.
inline double first_scale(const PosteriorData& data, const Group& group, Index image,
                          const double* R, Index k) {
    const double* mu = data.means[k].data;
    const Matrix<const double> landmarks = data.landmarks[image],
                               slope = data.slopes[image];
    const Index p = landmarks.size[1];
    double middle[2] = {}, origin[2] = {}, overlap = 0, square = 0, size = 0;
    for (int pass = 0; pass < 2; ++pass)
        for (Index e = 0; e < group.m; ++e)
            for (int a = 0; a < 2; ++a) {
                const Index j = group.index[e];
                double A[3];
                for (int c = 0; c < 3; ++c)
                    A[c] = R[3 * a + c] - slope[a][j] * R[6 + c];
                const double x = A[0] * mu[j] + A[1] * mu[p + j] + A[2] * mu[2 * p + j];
                const double w = landmarks[a][j];
                if (pass == 0) {
                    middle[a] += x / static_cast<double>(group.m);
                    origin[a] += w / static_cast<double>(group.m);
                } else {
                    overlap += (x - middle[a]) * (w - origin[a]);
                    square += (x - middle[a]) * (x - middle[a]);
                    size += (w - origin[a]) * (w - origin[a]);
                }
            }
    const double least = 0.1 * root(size / larger(square, TINY));
    return larger(overlap / larger(square, TINY), larger(least, TINY));
}

// Append an ascent that begins at the start of its origin.
template <class Lanes>
void add_ascent(const PosteriorData& data, const Group& group, Origin origin,
                Ascents<Lanes>& ascents) {
    const Index K = data.means.size[0], lane = ascents.count % width<Lanes>,
                image = group.image[origin.slot];
    const double* R = data.starts[image][origin.pair / K].data;
    Ascent<Lanes>& at = ascents[ascents.count];
    for (int e = 0; e < 9; ++e) at.view.R[e][lane] = static_cast<Number<Lanes>>(R[e]);
    const double log_scale = log(first_scale(data, group, image, R, origin.pair % K));
    at.view.log_scale[lane] = static_cast<Number<Lanes>>(log_scale);
    at.largest[lane] = static_cast<Number<Lanes>>(log_scale + log(MAX_GROWTH));
    ascents.origin[ascents.count++] = origin;
}

// Append ascents from every start under every component for all images of a group, if
// three landmarks are visible; blocks in a row have the same components.
template <class Lanes>
void add_all(const PosteriorData& data, const Group& group, Ascents<Lanes>& ascents) {
    const Index K = data.means.size[0],
                pairs = group.m < 3 ? 0 : ascents_per_image(data);
    for (Index first = 0; first < pairs; first += width<Lanes>)
        for (Index slot = 0; slot < group.count; ++slot)
            for (Index pair = first; pair < pairs && pair < first + width<Lanes>;
                 ++pair)
                if (is_finite(data.starts[group.image[slot]][pair / K].data[0]))
                    add_ascent(data, group, {slot, pair}, ascents);
}

// L + log pi_k of ascent i: its log likelihood, and the log weight of its component.
template <class Lanes>
double value_of(const PosteriorData& data, const Ascents<Lanes>& ascents, Index i) {
    return ascents[i].found.value[i % width<Lanes>] +
           data.log_weights[ascents.origin[i].pair % data.means.size[0]];
}

// Raise the best value so far of each image of the group to those of its ascents.
template <class Lanes>
void note_best(const PosteriorData& data, const Ascents<Lanes>& ascents, Group& group) {
    for (Index i = 0; i < ascents.count; ++i) {
        double& best = group.best[ascents.origin[i].slot];
        best = larger(best, value_of(data, ascents, i));
    }
}

// Move ascents that have converged to `search.finished`, and drop those that cannot
// come within `margin` of the best of their image any more.
template <class Lanes>
void remove_finished(const PosteriorData& data, double margin, Ascents<Lanes>& ascents,
                     Search& search) {
    const Index count = ascents.count;
    ascents.count = 0;
    for (Index i = 0; i < count; ++i) {
        const Ascent<Lanes>& at = ascents[i];
        const Index lane = i % width<Lanes>;
        const double most =
            value_of(data, ascents, i) + GAIN_FACTOR * at.predicted_gain[lane];
        if (!(most > search.group.best[ascents.origin[i].slot] - margin)) continue;
        if (at.moving[lane] > 0) ascents.append(ascents, i);
        else search.finished.append(ascents, i);
    }
    ascents.pad();
}

// Run all ascents of one precision for so many rounds at most; those that finish are
// moved to `search.finished`, or dropped where they are more than `margin` below the
// best.
template <class Lanes>
void run_ascents(const PosteriorData& data, Index rounds, double margin,
                 LaneWorkspace<Lanes>& lanes, Search& search) {
    Ascents<Lanes>& ascents = lanes.ascents;
    ascents.pad();
    for (Index b = 0; b < ascents.blocks(); ++b) {
        check_interrupt();
        gather(data, search.group, ascents.origin + b * width<Lanes>, lanes);
        begin(data, lanes.observed, lanes.space, ascents.block(b));
    }
    for (;; rounds -= ROUNDS_AT_ONCE) {
        note_best(data, ascents, search.group);
        remove_finished(data, margin, ascents, search);
        if (!ascents.count || rounds <= 0) return;
        for (Index b = 0; b < ascents.blocks(); ++b) {
            gather(data, search.group, ascents.origin + b * width<Lanes>, lanes);
            ascend(data, lanes.observed, ROUNDS_AT_ONCE, lanes.space, ascents.block(b));
        }
        for (Index i = 0; i < ascents.count; ++i)
            data.rounds[search.group.image[ascents.origin[i].slot]] += ROUNDS_AT_ONCE;
    }
}

// Run the ascents in double precision, then find value and Hessian at the end of all
// that finished within `margin` of the best. An image has failed where none of them
// ended on a stationary point, or where the value of one differs from what its ascent
// found.
inline void finish_all(const PosteriorData& data, double margin, Search& search) {
    Group& group = search.group;
    Ascents<Doubles>& finished = search.finished;
    LaneWorkspace<Doubles>& lanes = search.double_precision;
    for (Index slot = 0; slot < group.count; ++slot) group.best[slot] = -INFINITE;
    note_best(data, finished, group);
    run_ascents(data, MAX_ROUNDS, margin, lanes, search);
    for (Index i = 0; i < lanes.ascents.count; ++i) finished.append(lanes.ascents, i);
    const Index count = finished.count;
    finished.count = 0;
    for (Index i = 0; i < count; ++i)
        if (value_of(data, finished, i) > group.best[finished.origin[i].slot] - margin)
            finished.append(finished, i);
    finished.pad();
    for (Index b = 0; b < finished.blocks(); ++b) {
        check_interrupt();
        Ascent<Doubles>& at = finished.block(b);
        at.before = at.found.value;
        gather(data, group, finished.origin + b * WIDTH, lanes);
        evaluate_end(data, lanes.observed, lanes.space, at);
        find_hessian(data, lanes.observed, lanes.space, at);
        finish(at);
    }
    for (Index slot = 0; slot < group.count; ++slot) {
        bool is_stationary = false, agrees = true;
        for (Index i = 0; i < finished.count; ++i) {
            const double away =
                finished[i].found.value[i % WIDTH] - finished[i].before[i % WIDTH];
            if (finished.origin[i].slot != slot) continue;
            is_stationary = is_stationary || !(finished[i].moving[i % WIDTH] > 0);
            agrees = agrees && magnitude(away) < MAX_DISAGREEMENT;
        }
        group.failed[slot] = !(is_stationary && agrees);
    }
}

// Run ascents from all starts of the images of a group under every component, in double
// precision alone where `precise`. Those in `search.finished` are at most `margin`
// below the best of their image, in log likelihood and weight; what is still moving
// there ran out of rounds.
inline void ascend_all(const PosteriorData& data, double margin, bool precise,
                       Search& search) {
    Ascents<Singles>& singles = search.single_precision.ascents;
    Ascents<Doubles>& doubles = search.double_precision.ascents;
    singles.count = doubles.count = search.finished.count = 0;
    // what stands there is of another group
    for (Index& k : search.single_precision.component) k = -1;
    for (Index& k : search.double_precision.component) k = -1;
    for (Index slot = 0; slot < search.group.count; ++slot)
        search.group.best[slot] = -INFINITE;
    if (precise) add_all(data, search.group, doubles);
    else add_all(data, search.group, singles);
    run_ascents(data, MAX_SINGLE_ROUNDS, margin, search.single_precision, search);
    for (Index i = 0; i < singles.count; ++i)
        add_ascent(data, search.group, singles.origin[i], doubles);
    finish_all(data, margin, search);
}

}  // namespace shapefit
