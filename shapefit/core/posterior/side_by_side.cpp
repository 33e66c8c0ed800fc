#include "side_by_side.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

constexpr long ROUNDS = 2;  // after which ranks are closed
constexpr double HOPE = 2;  // how many times what a step promises a climb may still gain

// The components of one block of lanes.
void fetch(const Components& components, const Observed& seen, const long* pair, Pack& pack) {
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
double first_scale(const PosteriorData& data, const Observed& seen, const double* R, long k) {
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
    Climbs& going = search.going;
    going.count = search.arrived.count = 0;
    for (long i = 0; i < data.starts.size[1]; ++i) {
        const double* R = data.starts[image][i].data;
        if (!is_finite(R[0])) continue;
        for (long k = 0; k < K; ++k) {
            const long lane = going.count % WIDTH;
            LaneView& view = going[going.count].view;
            for (int e = 0; e < 9; ++e) view.R[e][lane] = R[e];
            view.log_scale[lane] = log(first_scale(data, search.seen, R, k));
            going.pair[going.count++] = K * i + k;
        }
    }
    going.pad();
}

double value_of(const PosteriorData& data, const Climbs& climbs, long i) {
    return climbs[i].found.value[i % WIDTH] + data.log_weights[climbs.pair[i] % data.means.size[0]];
}

double best_of(const PosteriorData& data, const Climbs& climbs, double best) {
    for (long i = 0; i < climbs.count; ++i) best = larger(best, value_of(data, climbs, i));
    return best;
}

// Those that have arrived leave, and so do those without hope to come near the best.
void close_ranks(const PosteriorData& data, double least, bool last, Search& search) {
    Climbs& going = search.going;
    const long count = going.count;
    going.count = 0;
    for (long i = 0; i < count; ++i) {
        const double hope = going[i].hope[i % WIDTH];
        if (!(value_of(data, going, i) + HOPE * hope > least)) continue;
        if (going[i].moving[i % WIDTH] > 0 && !last)
            going.append(going, i);
        else
            search.arrived.append(going, i);
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

Climbs::Climbs(Workspace& workspace, long most, long p)
    : pair(workspace.zeros<long>(most + WIDTH)),
      size_(climb_size(p)),
      lanes_(workspace.zeros<Lanes>((most + WIDTH - 1) / WIDTH * size_)) {}

void Climbs::copy(const Climbs& from, long i, long to) {
    const Lanes* source = from.lanes_ + i / WIDTH * size_;
    Lanes* target = lanes_ + to / WIDTH * size_;
    for (long e = 0; e < size_; ++e) target[e][to % WIDTH] = source[e][i % WIDTH];
    pair[to] = from.pair[i];
}

void Climbs::append(const Climbs& from, long i) { copy(from, i, count++); }

void Climbs::pad() {
    for (long to = count; to % WIDTH; ++to) copy(*this, count - 1, to);
}

Search::Search(Workspace& workspace, const PosteriorData& data)
    : components(workspace, data),
      seen(room_for_observed(workspace, data.means.size[2])),
      pack{workspace.zeros<Lanes>(3 * data.means.size[2]),
           workspace.zeros<Lanes>(9 * corner(data.means.size[2]))},
      space(workspace, data.means.size[2]),
      going(workspace, data.starts.size[1] * data.means.size[0], data.means.size[2]),
      arrived(workspace, data.starts.size[1] * data.means.size[0], data.means.size[2]) {}

long climb_all(const PosteriorData& data, long image, double margin, Search& search) {
    Climbs &going = search.going, &arrived = search.arrived;
    long steps = 0;
    double best = -INFINITE;
    place(data, image, search);
    for (long b = 0; b < going.blocks(); ++b) {
        fetch(search.components, search.seen, going.pair + b * WIDTH, search.pack);
        begin(data, search.seen, search.pack, search.space, going.block(b));
    }
    for (long rounds = 0;; rounds += ROUNDS) {
        best = best_of(data, going, best);
        close_ranks(data, best - margin, rounds >= data.most_rounds, search);
        if (!going.count) break;
        for (long b = 0; b < going.blocks(); ++b) {
            fetch(search.components, search.seen, going.pair + b * WIDTH, search.pack);
            climb(data, search.seen, search.pack, ROUNDS, search.space, going.block(b));
        }
        steps += ROUNDS * going.count;
    }
    const long count = arrived.count;
    arrived.count = 0;
    for (long i = 0; i < count; ++i)
        if (value_of(data, arrived, i) > best - margin) arrived.append(arrived, i);
    arrived.pad();
    for (long b = 0; b < arrived.blocks(); ++b) {
        fetch(search.components, search.seen, arrived.pair + b * WIDTH, search.pack);
        finish(data, search.seen, search.pack, search.space, arrived.block(b));
    }
    return steps;
}

}  // namespace shapefit::SHAPEFIT_LEVEL
