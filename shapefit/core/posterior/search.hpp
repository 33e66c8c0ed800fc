// The ascents of an image side by side, one a lane; those that have finished are dropped.
#pragma once

#include "ascent.hpp"

namespace shapefit {

constexpr long ROUNDS = 2;  // after which finished ascents are dropped
constexpr long QUICK = 16;  // rounds in single precision; what takes longer starts again in double
constexpr long MOST_ROUNDS = 200;  // in double
constexpr double AGREEMENT = 1;    // of single and double precision at the end, in log likelihood
constexpr double MOST_GROWTH = 100;  // of the scale, on the way up
constexpr double GAIN_FACTOR = 2;  // an ascent may still gain this many times the predicted gain

// The components as the lanes take them, side by side: mu (3 p, K), and C_jk (9, K) for k <= j; many of
// them in rows of whole pairs of vectors.
template <class Number>
struct Components {
    static constexpr long PAIR = 2 * sizeof(Doubles) / sizeof(Number);

    Components(Workspace& workspace, const PosteriorData& data)
        : count(data.means.size[0]),
          capacity(count < PAIR ? count : (count + PAIR - 1) / PAIR * PAIR),
          means(workspace.zeros<Number>(3 * data.means.size[2] * capacity)),
          covariances(workspace.zeros<Number>(9 * corner(data.means.size[2]) * capacity)) {
        const long p = data.means.size[2];
        for (long k = 0; k < count; ++k)
            for (long j = 0; j < p; ++j)
                for (int a = 0; a < 3; ++a) {
                    means[(3 * j + a) * capacity + k] = static_cast<Number>(data.means[k][a][j]);
                    for (long l = 0; l <= j; ++l)
                        for (int b = 0; b < 3; ++b)
                            covariances[(9 * (corner(j) + l) + 3 * a + b) * capacity + k] =
                                static_cast<Number>(data.covariances[k][a * p + j][b * p + l]);
                }
    }

    long count, capacity;
    Number *means, *covariances;
};

// A place for each lane.
template <class Lanes>
using Places = decltype(Lanes{} < Lanes{});

// row[at] of each lane. Shuffles of rows of whole pairs of vectors: faster than a gathering instruction.
template <class Lanes>
[[gnu::always_inline]] inline Lanes pick(const Number<Lanes>* row, long capacity, Places<Lanes> at) {
    constexpr long PAIR = 2 * width<Lanes>;
    Lanes found = {};
#if defined(__AVX512F__) && !defined(__clang__)
    if (capacity % PAIR == 0) {
        for (long first = 0; first < capacity; first += PAIR) {
            Lanes pair[2];
            memcpy(pair, row + first, sizeof pair);
            const Lanes some = __builtin_shuffle(pair[0], pair[1], at);  // by `at` modulo PAIR
            found = first ? (at >= static_cast<int>(first) ? some : found) : some;
        }
        return found;
    }
#endif
    for (int lane = 0; lane < width<Lanes>; ++lane) found[lane] = row[at[lane]];
    return found;
}

template <class Lanes>
struct Ascents {
    Ascents(Workspace& workspace, long most, long p)
        : p(p),
          pair(workspace.zeros<long>(most + width<Lanes>)),
          lanes(workspace.zeros<Ascent<Lanes>>((most + width<Lanes> - 1) / width<Lanes>)) {
        for (long b = 0; b * width<Lanes> < most; ++b) {
            lanes[b].inlier_probability = workspace.zeros<Lanes>(p);
            lanes[b].next = workspace.zeros<Lanes>(p);
        }
    }

    Ascent<Lanes>& block(long b) const { return lanes[b]; }
    Ascent<Lanes>& operator[](long i) const { return block(i / width<Lanes>); }
    long blocks() const { return (count + width<Lanes> - 1) / width<Lanes>; }
    // Copy ascent i of some ascents, or of these, where i is not before the end.
    template <class Others>
    void append(const Ascents<Others>& from, long i) {
        const long to_lane = count % width<Lanes>, lane = i % width<Others>;
        each_pair((*this)[count], from[i], p, [=](Lanes& to, const Others& given) {
            to[to_lane] = static_cast<Number<Lanes>>(given[lane]);
        });
        pair[count++] = from.pair[i];
    }
    // Fill the last block with copies of its ascents, in turns.
    void pad() {
        const long own = count;
        while (count % width<Lanes>) append(*this, count - own % width<Lanes>);
        count = own;
    }

    const long p;
    long count = 0;
    long* pair;  // of start and component: K start + component
    Ascent<Lanes>* lanes;
};

// What the lanes of one precision work with.
template <class Lanes>
struct Side {
    Side(Workspace& workspace, const PosteriorData& data)
        : components(workspace, data), observed(workspace, data.means.size[2]),
          pack{workspace.zeros<Lanes>(3 * data.means.size[2]),
               workspace.zeros<Lanes>(9 * corner(data.means.size[2]))},
          space(workspace, data.means.size[2]),
          ascents(workspace, data.starts.size[1] * data.means.size[0], data.means.size[2]) {}

    Components<Number<Lanes>> components;
    Observed<Number<Lanes>> observed;
    Pack<Lanes> pack;
    AscentSpace<Lanes> space;
    Ascents<Lanes> ascents;
};

// Ascents begin in single precision; their end, and those that take long, are in double, as is everything
// where single precision fails.
struct Search {
    Search(Workspace& workspace, const PosteriorData& data)
        : going(workspace, data),
          late(workspace, data),
          arrived(workspace, data.starts.size[1] * data.means.size[0], data.means.size[2]) {}

    Side<Singles> going;
    Side<Doubles> late;
    Ascents<Doubles> arrived;
};

// Component `of` of each lane, as far as it is seen.
template <class Lanes>
void fetch(Places<Lanes> of, Side<Lanes>& side) {
    const Observed<Number<Lanes>>& observed = side.observed;
    const Pack<Lanes>& pack = side.pack;
    const auto& from = side.components;
    for (long j = 0; j < observed.m; ++j) {
        for (int a = 0; a < 3; ++a)
            pack.mean[3 * j + a] = pick<Lanes>(from.means + (3 * observed.index[j] + a) * from.capacity, from.capacity, of);
        for (long k = 0; k <= j; ++k) {
            const Number<Lanes>* C = from.covariances + 9 * (corner(observed.index[j]) + observed.index[k]) * from.capacity;
            Lanes* to = pack.covariance + 9 * (corner(j) + k);
            for (int e = 0; e < 9; ++e) to[e] = pick<Lanes>(C + e * from.capacity, from.capacity, of);
        }
    }
}

// The components of one block of ascents.
template <class Lanes>
void fetch(long b, const Ascents<Lanes>& ascents, Side<Lanes>& side) {
    Places<Lanes> of;
    for (int lane = 0; lane < width<Lanes>; ++lane)
        of[lane] = ascents.pair[b * width<Lanes> + lane] % side.components.count;
    fetch(of, side);
}

// The s that fits s A mu + t to the landmarks best.
inline double first_scale(const PosteriorData& data, const Observed<double>& observed, const double* R, long k) {
    const long p = data.means.size[2];
    const double* mu = data.means[k].data;
    double middle[2] = {}, origin[2] = {}, overlap = 0, square = 0, size = 0;
    for (int pass = 0; pass < 2; ++pass)
        for (long j = 0; j < observed.m; ++j)
            for (int a = 0; a < 2; ++a) {
                const long e = observed.index[j];
                double A[3];
                for (int c = 0; c < 3; ++c) A[c] = R[3 * a + c] - observed.slope[2 * j + a] * R[6 + c];
                const double x = A[0] * mu[e] + A[1] * mu[p + e] + A[2] * mu[2 * p + e];
                const double w = observed.w[2 * j + a];
                if (pass == 0) {
                    middle[a] += x / static_cast<double>(observed.m);
                    origin[a] += w / static_cast<double>(observed.m);
                } else {
                    overlap += (x - middle[a]) * (w - origin[a]);
                    square += (x - middle[a]) * (x - middle[a]);
                    size += (w - origin[a]) * (w - origin[a]);
                }
            }
    const double least = 0.1 * root(size / larger(square, TINY));
    return larger(overlap / larger(square, TINY), larger(least, TINY));
}

// One more ascent, from its start.
template <class Lanes>
void add_ascent(const PosteriorData& data, long image, long pair, const Observed<double>& observed,
           Ascents<Lanes>& ascents) {
    const long K = data.means.size[0], lane = ascents.count % width<Lanes>;
    const double* R = data.starts[image][pair / K].data;
    LaneView<Lanes>& view = ascents[ascents.count].view;
    for (int e = 0; e < 9; ++e) view.R[e][lane] = static_cast<Number<Lanes>>(R[e]);
    const double s = first_scale(data, observed, R, pair % K);
    view.log_scale[lane] = static_cast<Number<Lanes>>(log(s));
    ascents[ascents.count].largest[lane] = static_cast<Number<Lanes>>(log(s * MOST_GROWTH));
    ascents.pair[ascents.count++] = pair;
}

template <class Lanes>
double value_of(const PosteriorData& data, const Ascents<Lanes>& ascents, long i) {
    return ascents[i].found.value[i % width<Lanes>] +
           data.log_weights[ascents.pair[i] % data.means.size[0]];
}

// Ascents that have converged leave, and so do those that cannot come near the best any more.
template <class Lanes>
void drop_finished(const PosteriorData& data, double least, Ascents<Lanes>& going, Search& search) {
    const long count = going.count;
    going.count = 0;
    for (long i = 0; i < count; ++i) {
        const Ascent<Lanes>& at = going[i];
        const long lane = i % width<Lanes>;
        if (!(value_of(data, going, i) + GAIN_FACTOR * at.predicted_gain[lane] > least)) continue;
        if (at.moving[lane] > 0)
            going.append(going, i);
        else
            search.arrived.append(going, i);
    }
    going.pad();
}

// At most so many rounds for all that have been placed; returns the steps taken.
template <class Lanes>
long run_ascents(const PosteriorData& data, long rounds, double margin, double& best, Side<Lanes>& going,
           Search& search) {
    long steps = 0;
    going.ascents.pad();
    for (long b = 0; b < going.ascents.blocks(); ++b) {
        fetch(b, going.ascents, going);
        begin(data, going.observed, going.pack, going.space, going.ascents.block(b));
    }
    for (;; rounds -= ROUNDS) {
        for (long i = 0; i < going.ascents.count; ++i)
            best = larger(best, value_of(data, going.ascents, i));
        drop_finished(data, best - margin, going.ascents, search);
        if (!going.ascents.count || rounds <= 0) return steps;
        for (long b = 0; b < going.ascents.blocks(); ++b) {
            fetch(b, going.ascents, going);
            ascent(data, going.observed, going.pack, ROUNDS, going.space, going.ascents.block(b));
        }
        steps += ROUNDS * going.ascents.count;
    }
}

// Every start under every component.
template <class Lanes>
void add_all(const PosteriorData& data, long image, const Observed<double>& observed,
               Ascents<Lanes>& ascents) {
    ascents.count = 0;
    for (long i = 0; i < data.starts.size[1]; ++i)
        if (is_finite(data.starts[image][i].data[0]))
            for (long k = 0; k < data.means.size[0]; ++k)
                add_ascent(data, image, data.means.size[0] * i + k, observed, ascents);
}

// The Hessians of a block by differences of gradients, inlier probabilities held: an ascent and a direction
// a lane. The ascents of `side` are overwritten.
inline void find_hessians(const PosteriorData& data, long b, const Ascents<Doubles>& ascents, Side<Doubles>& side) {
    const long rest = ascents.count - b * WIDTH, count = rest < WIDTH ? rest : WIDTH;
    Ascent<Doubles>& turned = side.ascents.block(0);
    Likelihood<Doubles>& found = side.space.found;
    for (long task = 0; task < VIEW * count; task += WIDTH) {
        Doubles step[VIEW] = {};
        side.ascents.count = 0;
        for (long lane = 0; lane < WIDTH; ++lane) {
            side.ascents.append(ascents, b * WIDTH + (task + lane) % count);
            step[(task + lane) / count % VIEW][lane] = DIFFERENCE;
        }
        fetch(0, side.ascents, side);
        move(turned.view, step, turned.view);
        find_likelihood(data, side.observed, side.pack, turned.view, turned.inlier_probability, false, true,
                        side.space.likelihood, found, side.space.next);
        for (int e = 0; e < VIEW * WIDTH; ++e) {
            const long lane = e % WIDTH, i = (task + lane) / count, j = e / WIDTH;
            for (long to = (task + lane) % count; i < VIEW && to < WIDTH; to += count)  // and its copies
                ascents.block(b).curvature[VIEW * i + j][to] =
                    (found.gradient[j][lane] - turned.found.gradient[j][lane]) / DIFFERENCE;
        }
    }
}

// The ascents that are `late`; then the likelihood in double precision and its Hessian, where those stand
// that are near the best. Whether one of them stands on a stationary point, and all are worth what the
// ascent took them for.
inline bool finish_all(const PosteriorData& data, double margin, long& steps, Search& search) {
    Ascents<Doubles>& arrived = search.arrived;
    Side<Doubles>& late = search.late;
    double best = -INFINITE;
    for (long i = 0; i < arrived.count; ++i) best = larger(value_of(data, arrived, i), best);
    steps += run_ascents(data, MOST_ROUNDS, margin, best, late, search);
    for (long i = 0; i < late.ascents.count; ++i) arrived.append(late.ascents, i);
    const long count = arrived.count;
    arrived.count = 0;
    for (long i = 0; i < count; ++i)
        if (value_of(data, arrived, i) > best - margin) arrived.append(arrived, i);
    arrived.pad();
    Doubles distance = {}, standing = {};
    for (long b = 0; b < arrived.blocks(); ++b) {
        Ascent<Doubles>& at = arrived.block(b);
        const Doubles before = at.found.value;
        fetch(b, arrived, late);
        settle(data, late.observed, late.pack, late.space, at);
        find_hessians(data, b, arrived, late);
        finish(at);
        const Doubles difference = magnitude(at.found.value - before);
        distance = difference < AGREEMENT ? distance : all(1.0);
        standing = larger(1.0 - at.moving, standing);
    }
    return largest(standing) > 0 && !(largest(distance) > 0);
}

// Ascent from all starts of an image under every component. What has `arrived` is not further than
// `margin` below the best, in log likelihood and weight, and finished; what is still moving there ran
// out of rounds. Returns the steps taken.
inline long ascend_all(const PosteriorData& data, long image, double margin, Search& search) {
    Side<Singles>& going = search.going;
    Side<Doubles>& late = search.late;
    Ascents<Doubles>& arrived = search.arrived;
    double best = -INFINITE;
    going.observed.take(data, image);
    add_all(data, image, late.observed, going.ascents);
    late.ascents.count = arrived.count = 0;
    long steps = run_ascents(data, QUICK, margin, best, going, search);
    for (long i = 0; i < going.ascents.count; ++i)
        add_ascent(data, image, going.ascents.pair[i], late.observed, late.ascents);
    if (finish_all(data, margin, steps, search)) return steps;
    // single precision failed
    arrived.count = 0;
    add_all(data, image, late.observed, late.ascents);
    finish_all(data, margin, steps, search);
    return steps;
}

}  // namespace shapefit
