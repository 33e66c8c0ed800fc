#include "posterior.hpp"

#include "climb.hpp"
#include "modes.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

constexpr double SAME_VIEW = 1e-2;    // rotations as close are one mode (Frobenius norm)
constexpr double SADDLE = 50;         // in log evidence
constexpr double NEGLIGIBLE = 9.2;    // a mode so far below the best in log evidence is left out
constexpr double LOG_TWO_PI = 1.8378770664093453;
constexpr int MIXED[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // coordinates of a landmark

long greatest_divisor(long a, long b) { return b ? greatest_divisor(b, a % b) : a; }

// Components in the order of the lanes: lane l of pack i stands for component (WIDTH i + l) mod K.
struct Packs {
    long count;
    Pack* packs;
};

Packs arrange(Workspace& workspace, const PosteriorData& data) {
    const long K = data.means.size[0], p = data.means.size[2], d = 3 * p;
    Packs all{K / greatest_divisor(K, WIDTH), nullptr};
    all.packs = workspace.zeros<Pack>(all.count);
    for (long i = 0; i < all.count; ++i) {
        Pack& pack = all.packs[i];
        pack.mean = workspace.zeros<Lanes>(3 * p);
        pack.covariance = workspace.zeros<Lanes>(9 * corner(p));
        for (int lane = 0; lane < WIDTH; ++lane) {
            const long k = (WIDTH * i + lane) % K;
            const double *mean = data.means[k].data, *C = data.covariances[k].data;
            for (long j = 0; j < p; ++j)
                for (int a = 0; a < 3; ++a) {
                    pack.mean[3 * j + a][lane] = mean[a * p + j];
                    for (long l = 0; l <= j; ++l)
                        for (int b = 0; b < 3; ++b)
                            pack.covariance[9 * (corner(j) + l) + 3 * a + b][lane] =
                                C[(a * p + j) * d + b * p + l];
                }
        }
    }
    return all;
}

struct Search {
    Search(Workspace& workspace, const PosteriorData& data)
        : pairs(data.starts.size[1] * data.means.size[0]),
          blocks((pairs + WIDTH - 1) / WIDTH),
          packs(arrange(workspace, data)),
          seen(room_for_observed(workspace, data.landmarks.size[2])),
          space(workspace, data.landmarks.size[2]),
          mode_space(workspace, data.landmarks.size[2]),
          climbs(workspace.zeros<Climb>(blocks)),
          start_of(workspace.zeros<long>(data.starts.size[1])),
          modes(workspace.zeros<Mode>(blocks * WIDTH)),
          order(workspace.zeros<long>(blocks * WIDTH)),
          means(workspace.zeros<double>(3 * data.landmarks.size[2])),
          covariance(workspace.zeros<double>(9 * data.landmarks.size[2] * data.landmarks.size[2])) {
        const long p = data.landmarks.size[2];
        for (long b = 0; b < blocks; ++b) new (climbs + b) Climb(workspace, p);
        for (long i = 0; i < blocks * WIDTH; ++i) modes[i].belief = workspace.zeros<double>(p);
    }

    long pairs, blocks;
    Packs packs;
    Observed seen;
    LikelihoodSpace space;
    ModeSpace mode_space;
    Climb* climbs;
    long* start_of;
    Mode* modes;
    long* order;
    double *means, *covariance;
};

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

// Climb from all starts; how many starts there are.
long climb_all(const PosteriorData& data, long image, Search& search, int64_t& steps) {
    const long K = data.means.size[0];
    long starts = 0;
    for (long i = 0; i < data.starts.size[1]; ++i)
        if (is_finite(data.starts[image][i].data[0])) search.start_of[starts++] = i;
    const long pairs = starts * K;
    double best = -INFINITE;
    for (long b = 0; b * WIDTH < pairs; ++b) {
        Climb& at = search.climbs[b];
        Lanes log_weight;
        for (int lane = 0; lane < WIDTH; ++lane) {
            const long pair = smaller(static_cast<double>(b * WIDTH + lane), static_cast<double>(pairs - 1));
            const long k = (b * WIDTH + lane) % K;
            const double* R = data.starts[image][search.start_of[pair / K]].data;
            for (int e = 0; e < 9; ++e) at.view.R[e][lane] = R[e];
            at.view.log_scale[lane] = log(first_scale(data, search.seen, R, k));
            log_weight[lane] = data.log_weights[k];
        }
        steps += climb(data, search.seen, search.packs.packs[b % search.packs.count], log_weight, best,
                       search.space, at);
    }
    return pairs;
}

// Gather the maxima that may count, with their evidence.
long gather(const PosteriorData& data, long pairs, Search& search) {
    const long K = data.means.size[0];
    double best = -INFINITE;
    for (long i = 0; i < pairs; ++i)
        best = larger(best, search.climbs[i / WIDTH].found.value[i % WIDTH] + data.log_weights[i % K]);
    long count = 0;
    for (long b = 0; b * WIDTH < pairs; ++b) {
        Climb& at = search.climbs[b];
        bool alive[WIDTH] = {}, any = false;
        for (int lane = 0; lane < WIDTH && b * WIDTH + lane < pairs; ++lane) {
            const double value = at.found.value[lane] + data.log_weights[(b * WIDTH + lane) % K];
            alive[lane] = value > best - NEGLIGIBLE - 5;  // Laplace's term may yet lift it
            any = any || alive[lane];
        }
        if (!any) continue;
        measure_hessian(data, search.seen, search.packs.packs[b % search.packs.count], search.space, at);
        for (int lane = 0; lane < WIDTH; ++lane) {
            if (!alive[lane]) continue;
            Mode& mode = search.modes[count];
            double L[VIEW][VIEW], log_det = 0;
            bool definite = true;
            for (int i = 0; i < VIEW; ++i)
                for (int j = 0; j <= i; ++j) {
                    double rest = at.hessian[VIEW * i + j][lane];
                    for (int k = 0; k < j; ++k) rest -= L[i][k] * L[j][k];
                    definite = definite && (i != j || rest > 1e-6);
                    L[i][j] = i == j ? root(larger(rest, LEAST_CURVATURE)) : rest / L[j][j];
                    if (i == j) log_det += 2 * log(L[i][i]);
                }
            mode.component = (b * WIDTH + lane) % K;
            for (int e = 0; e < 9; ++e) mode.R[e] = at.view.R[e][lane];
            mode.log_scale = at.view.log_scale[lane];
            for (int e = 0; e < VIEW * VIEW; ++e) mode.hessian[e] = at.hessian[e][lane];
            for (long j = 0; j < search.seen.m; ++j) mode.belief[j] = at.belief[j][lane];
            mode.surprise = at.found.surprise[lane];
            mode.log_evidence = at.found.value[lane] + data.log_weights[mode.component] +
                                0.5 * (VIEW * LOG_TWO_PI - log_det);
            // A saddle counts only where no climb ends on a maximum.
            if (!definite) mode.log_evidence -= SADDLE;
            ++count;
        }
    }
    return count;
}

// Sort by evidence and leave out what was found before and what is negligible.
long rank(Search& search, long count) {
    for (long i = 0; i < count; ++i) {
        long place = i;
        for (; place > 0 && search.modes[search.order[place - 1]].log_evidence <
                                search.modes[i].log_evidence;
             --place)
            search.order[place] = search.order[place - 1];
        search.order[place] = i;
    }
    long kept = 0;
    for (long i = 0; i < count; ++i) {
        const Mode& mode = search.modes[search.order[i]];
        if (mode.log_evidence < search.modes[search.order[0]].log_evidence - NEGLIGIBLE) break;
        bool known = false;
        for (long o = 0; o < kept && !known; ++o) {
            const Mode& other = search.modes[search.order[o]];
            double apart = 0;
            for (int e = 0; e < 9; ++e) apart += square(mode.R[e] - other.R[e]);
            known = other.component == mode.component && apart < SAME_VIEW * SAME_VIEW;
        }
        if (!known) search.order[kept++] = search.order[i];
    }
    return kept;
}

void fail(const PosteriorData& data, long image) {
    const long d = 3 * data.landmarks.size[2];
    for (long e = 0; e < d; ++e)
        data.mean[image].data[e] = data.deviation[image].data[e] =
            data.correlation[image].data[e] = NOT_A_NUMBER;
    if (data.covariance.size[0])
        for (long e = 0; e < d * d; ++e) data.covariance[image].data[e] = NOT_A_NUMBER;
    for (long j = 0; j < d / 3; ++j) data.belief[image][j] = NOT_A_NUMBER;
    for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = NOT_A_NUMBER;
    data.scale[image] = data.log_evidence[image] = data.surprise[image] = NOT_A_NUMBER;
}

void store(const PosteriorData& data, long image, long rank, const Search& search, const Mode& mode,
           const double* mean, const double* covariance) {
    const long p = data.landmarks.size[2], d = 3 * p;
    data.mode_component[image][rank] = mode.component;
    data.mode_scale[image][rank] = exp(mode.log_scale);
    data.mode_log_evidence[image][rank] = mode.log_evidence;
    for (int e = 0; e < 9; ++e) data.mode_rotation[image][rank].data[e] = mode.R[e];
    for (long e = 0; e < d; ++e) data.mode_mean[image][rank].data[e] = mean[e];
    for (long e = 0; e < d * d; ++e) data.mode_covariance[image][rank].data[e] = covariance[e];
    for (long j = 0; j < p; ++j) data.mode_belief[image][rank][j] = NOT_A_NUMBER;
    for (long j = 0; j < search.seen.m; ++j)
        data.mode_belief[image][rank][search.seen.index[j]] = mode.belief[j];
}

// Mean and covariance of the mixture of the first `kept` modes.
void combine(const PosteriorData& data, long image, Search& search, long kept) {
    const long p = data.landmarks.size[2], d = 3 * p;
    const double best = search.modes[search.order[0]].log_evidence;
    double total = 0, surprise = 0;
    for (long i = 0; i < kept; ++i) total += exp(search.modes[search.order[i]].log_evidence - best);
    double* mean = data.mean[image].data;
    double* square_of = data.deviation[image].data;
    double* mixed = data.correlation[image].data;  // the covariances of MIXED first
    double* full = data.covariance.size[0] ? data.covariance[image].data : nullptr;
    for (long e = 0; e < d; ++e) mean[e] = square_of[e] = mixed[e] = 0;
    for (long e = 0; full && e < d * d; ++e) full[e] = 0;
    for (long j = 0; j < p; ++j) data.belief[image][j] = NOT_A_NUMBER;
    for (long j = 0; j < search.seen.m; ++j) data.belief[image][search.seen.index[j]] = 0;
    double before = 0;  // the share of the modes so far
    for (long i = 0; i < kept; ++i) {
        const Mode& mode = search.modes[search.order[i]];
        const double share = exp(mode.log_evidence - best) / total;
        describe(data, search.seen, mode, search.mode_space, search.means, search.covariance);
        const double step = share / (before + share), apart = before * step;
        // the mean moves by its share; what lies between joins the covariance
        for (long e = 0; e < d; ++e) {
            const double difference = search.means[e] - mean[e];
            square_of[e] += share * search.covariance[e * d + e] + apart * square(difference);
            if (full)
                for (long f = 0; f < d; ++f)
                    full[e * d + f] += share * search.covariance[e * d + f] +
                                       apart * difference * (search.means[f] - mean[f]);
        }
        for (long e = 0; e < d; ++e) {
            const long first = MIXED[e / p][0] * p + e % p, second = MIXED[e / p][1] * p + e % p;
            mixed[e] += share * search.covariance[first * d + second] +
                        apart * (search.means[first] - mean[first]) * (search.means[second] - mean[second]);
        }
        for (long e = 0; e < d; ++e) mean[e] += step * (search.means[e] - mean[e]);
        before += share;
        surprise += share * mode.surprise;
        for (long j = 0; j < search.seen.m; ++j)
            data.belief[image][search.seen.index[j]] += share * mode.belief[j];
        if (i < data.mode_component.size[1])
            store(data, image, i, search, mode, search.means, search.covariance);
    }
    for (long e = 0; e < d; ++e) square_of[e] = root(larger(square_of[e], 0.0));
    for (long e = 0; e < d; ++e)
        mixed[e] /= larger(square_of[MIXED[e / p][0] * p + e % p] * square_of[MIXED[e / p][1] * p + e % p], TINY);
    const Mode& first = search.modes[search.order[0]];
    for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = first.R[e];
    data.scale[image] = exp(first.log_scale);
    data.log_evidence[image] = best + log(total);
    data.surprise[image] = surprise;
}

}  // namespace

void find_posterior(const PosteriorData& data, Range range) {
    Workspace workspace;
    Search search(workspace, data);
    for (long image = range.first; image < range.last; ++image) {
        data.rounds[image] = 0;
        for (long i = 0; i < data.mode_component.size[1]; ++i) {
            data.mode_component[image][i] = -1;
            data.mode_log_evidence[image][i] = -INFINITE;
        }
        observe(data, image, search.seen);
        const long pairs = search.seen.m < 3 ? 0 : climb_all(data, image, search, data.rounds[image]);
        const long kept = pairs ? rank(search, gather(data, pairs, search)) : 0;
        if (kept)
            combine(data, image, search, kept);
        else
            fail(data, image);
    }
}

}  // namespace shapefit::SHAPEFIT_LEVEL
