#include "side_by_side.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

constexpr long ROUNDS = 2;  // after which ranks are closed
constexpr double HOPE = 2;  // how many times what a step promises a climb may still gain

// The components of one block of lanes.
template <class Lanes>
void fetch(const Components& components, long b, Side<Lanes>& side) {
    constexpr int WIDTH = width<Lanes>;
    const Observed<Number<Lanes>>& seen = side.seen;
    const Pack<Lanes>& pack = side.pack;
    const long* pair = side.climbs.pair + b * WIDTH;
    const double *mean[WIDTH], *C[WIDTH];
    for (int lane = 0; lane < WIDTH; ++lane) {
        mean[lane] = components.means[pair[lane] % components.count].data;
        C[lane] = components.covariances[pair[lane] % components.count].data;
    }
    for (long j = 0; j < seen.m; ++j) {
        for (int a = 0; a < 3; ++a)
            for (int lane = 0; lane < WIDTH; ++lane)
                pack.mean[3 * j + a][lane] = mean[lane][3 * seen.index[j] + a];
        for (long k = 0; k <= j; ++k) {
            const long from = 9 * (corner(seen.index[j]) + seen.index[k]);
            Lanes* to = pack.covariance + 9 * (corner(j) + k);
            for (int e = 0; e < 9; ++e)
                for (int lane = 0; lane < WIDTH; ++lane) to[e][lane] = C[lane][from + e];
        }
    }
}

// The s that fits s A mu + t to the landmarks best.
double first_scale(const PosteriorData& data, const Observed<double>& seen, const double* R, long k) {
    const long p = data.means.size[2];
    const double* mu = data.means[k].data;
    double middle[2] = {}, origin[2] = {}, overlap = 0, square = 0, size = 0;
    for (int pass = 0; pass < 2; ++pass)
        for (long j = 0; j < seen.m; ++j)
            for (int a = 0; a < 2; ++a) {
                const long e = seen.index[j];
                double A[3];
                for (int c = 0; c < 3; ++c) A[c] = R[3 * a + c] - seen.slope[2 * j + a] * R[6 + c];
                const double x = A[0] * mu[e] + A[1] * mu[p + e] + A[2] * mu[2 * p + e];
                const double w = seen.w[2 * j + a];
                if (pass == 0) {
                    middle[a] += x / static_cast<double>(seen.m);
                    origin[a] += w / static_cast<double>(seen.m);
                } else {
                    overlap += (x - middle[a]) * (w - origin[a]);
                    square += (x - middle[a]) * (x - middle[a]);
                    size += (w - origin[a]) * (w - origin[a]);
                }
            }
    const double least = 0.1 * root(size / larger(square, TINY));
    return larger(overlap / larger(square, TINY), larger(least, TINY));
}

// A climb for every start and component.
void place(const PosteriorData& data, long image, Search& search) {
    const long K = data.means.size[0];
    Climbs<SingleLanes>& going = search.going.climbs;
    going.count = search.arrived.climbs.count = 0;
    for (long i = 0; i < data.starts.size[1]; ++i) {
        const double* R = data.starts[image][i].data;
        if (!is_finite(R[0])) continue;
        for (long k = 0; k < K; ++k) {
            const long lane = going.count % width<SingleLanes>;
            LaneView<SingleLanes>& view = going[going.count].view;
            for (int e = 0; e < 9; ++e) view.R[e][lane] = static_cast<float>(R[e]);
            view.log_scale[lane] = static_cast<float>(log(first_scale(data, search.arrived.seen, R, k)));
            going.pair[going.count++] = K * i + k;
        }
    }
    going.pad();
}

template <class Lanes>
double value_of(const PosteriorData& data, const Climbs<Lanes>& climbs, long i) {
    return climbs[i].found.value[i % width<Lanes>] +
           data.log_weights[climbs.pair[i] % data.means.size[0]];
}

// Those that have arrived leave, and so do those without hope to come near the best.
void close_ranks(const PosteriorData& data, double least, bool last, Search& search) {
    Climbs<SingleLanes>& going = search.going.climbs;
    const long count = going.count;
    going.count = 0;
    for (long i = 0; i < count; ++i) {
        const Climb<SingleLanes>& at = going[i];
        const long lane = i % width<SingleLanes>;
        if (!(value_of(data, going, i) + HOPE * at.hope[lane] > least)) continue;
        if (at.moving[lane] > 0 && !last)
            going.append(going, i);
        else
            search.arrived.climbs.append(going, i);
    }
    going.pad();
}

}  // namespace

Components::Components(Workspace& workspace, const PosteriorData& data)
    : count(data.means.size[0]),
      means(workspace.matrix<double>(count, 3 * data.means.size[2])),
      covariances(workspace.matrix<double>(count, 9 * corner(data.means.size[2]))) {
    const long p = data.means.size[2];
    for (long k = 0; k < count; ++k)
        for (long j = 0; j < p; ++j)
            for (int a = 0; a < 3; ++a) {
                means[k][3 * j + a] = data.means[k][a][j];
                for (long l = 0; l <= j; ++l)
                    for (int b = 0; b < 3; ++b)
                        covariances[k][9 * (corner(j) + l) + 3 * a + b] =
                            data.covariances[k][a * p + j][b * p + l];
            }
}

template <class Lanes>
Climbs<Lanes>::Climbs(Workspace& workspace, long most, long p)
    : pair(workspace.zeros<long>(most + width<Lanes>)),
      size(climb_size<Lanes>(p)),
      lanes(workspace.zeros<Lanes>((most + width<Lanes> - 1) / width<Lanes> * size)) {}

template <class Lanes>
template <class Others>
void Climbs<Lanes>::append(const Climbs<Others>& from, long i) {
    const Others* source = from.lanes + i / width<Others> * size;
    Lanes* target = lanes + count / width<Lanes> * size;
    for (long e = 0; e < size; ++e)
        target[e][count % width<Lanes>] = static_cast<Number<Lanes>>(source[e][i % width<Others>]);
    pair[count++] = from.pair[i];
}

template <class Lanes>
void Climbs<Lanes>::pad() {
    const long own = count;
    while (count % width<Lanes>) append(*this, own - 1);
    count = own;
}

template <class Lanes>
Side<Lanes>::Side(Workspace& workspace, const PosteriorData& data)
    : seen(room_for_observed<Number<Lanes>>(workspace, data.means.size[2])),
      pack{workspace.zeros<Lanes>(3 * data.means.size[2]),
           workspace.zeros<Lanes>(9 * corner(data.means.size[2]))},
      space(workspace, data.means.size[2]),
      climbs(workspace, data.starts.size[1] * data.means.size[0], data.means.size[2]) {}

Search::Search(Workspace& workspace, const PosteriorData& data)
    : components(workspace, data), going(workspace, data), arrived(workspace, data) {}

long climb_all(const PosteriorData& data, long image, double margin, Search& search) {
    Side<SingleLanes>& going = search.going;
    Side<Lanes>& arrived = search.arrived;
    long steps = 0;
    double best = -INFINITE;
    observe(data, image, going.seen);
    place(data, image, search);
    for (long b = 0; b < going.climbs.blocks(); ++b) {
        fetch(search.components, b, going);
        begin(data, going.seen, going.pack, going.space, going.climbs.block(b));
    }
    for (long rounds = 0;; rounds += ROUNDS) {
        for (long i = 0; i < going.climbs.count; ++i)
            best = larger(best, value_of(data, going.climbs, i));
        close_ranks(data, best - margin, rounds >= data.most_rounds, search);
        if (!going.climbs.count) break;
        for (long b = 0; b < going.climbs.blocks(); ++b) {
            fetch(search.components, b, going);
            climb(data, going.seen, going.pack, ROUNDS, going.space, going.climbs.block(b));
        }
        steps += ROUNDS * going.climbs.count;
    }
    const long count = arrived.climbs.count;
    arrived.climbs.count = 0;
    for (long i = 0; i < count; ++i)
        if (value_of(data, arrived.climbs, i) > best - margin) arrived.climbs.append(arrived.climbs, i);
    arrived.climbs.pad();
    for (long b = 0; b < arrived.climbs.blocks(); ++b) {
        fetch(search.components, b, arrived);
        finish(data, arrived.seen, arrived.pack, arrived.space, arrived.climbs.block(b));
    }
    return steps;
}

}  // namespace shapefit::SHAPEFIT_LEVEL
