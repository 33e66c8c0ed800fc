#include "../base/registry.hpp"
#include "../base/small_matrices.hpp"
#include "data.hpp"
#include "modes.hpp"
#include "search.hpp"

namespace shapefit {

// The posterior over shape and view of each image, its modes combined.

// Climb from every start under every component; weigh the maxima by their evidence, the view
// integrated out by Laplace's approximation; mean and covariance of the mixture of those that count.
void find_posterior(const PosteriorData& data, Range range);

namespace {

constexpr double SAME_VIEW = 1e-2;    // rotations as close are one mode (Frobenius norm)
constexpr double NO_MAXIMUM = 50;     // what a point that is none loses, in log evidence
constexpr double NEGLIGIBLE = 6;      // a mode so far below the best in log evidence is left out
constexpr double LAPLACE = 1;         // by which the view integrated out may lift one over another
constexpr int MIXED[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // coordinates of a landmark

struct Combination {
    Combination(Workspace& workspace, const PosteriorData& data)
        : space(workspace, data.landmarks.size[2]),
          modes(workspace.zeros<Mode>(data.starts.size[1] * data.means.size[0])),
          order(workspace.zeros<long>(data.starts.size[1] * data.means.size[0])),
          mean(workspace.zeros<double>(3 * data.landmarks.size[2])) {
        for (long i = 0; i < data.starts.size[1] * data.means.size[0]; ++i)
            modes[i].belief = workspace.zeros<double>(data.landmarks.size[2]);
    }

    ModeSpace space;
    Mode* modes;
    long* order;
    double* mean;
};

// The root of the covariance of the view, (H + I)^-1, where no direction is less than flat; returns
// log det (H + I), and whether H is positive definite.
struct Curvature {
    double log_det;
    bool definite;
};

Curvature weigh_view(const Climb<Doubles>& at, long lane, double* root_of) {
    double H[VIEW * VIEW], values[VIEW], axes[VIEW * VIEW], log_det = 0;
    for (int e = 0; e < VIEW * VIEW; ++e) H[e] = at.curvature[e][lane];
    symmetric_eigen({H, {VIEW, VIEW}}, {values, {VIEW}}, {axes, {VIEW, VIEW}});
    for (int i = 0; i < VIEW; ++i) {
        const double lifted = larger(values[i], 0.0) + CURVATURE_OF_PRIOR;
        log_det += log(lifted);
        for (int e = 0; e < VIEW; ++e) root_of[VIEW * i + e] = axes[VIEW * i + e] / root(lifted);
    }
    return {log_det, values[0] > 1e-6};
}

// The point on which climb i ended, with its evidence.
void weigh(const PosteriorData& data, const Search& search, long i, Mode& mode) {
    const Climbs<Doubles>& climbs = search.arrived;
    Climb<Doubles>& at = climbs[i];
    const long lane = i % WIDTH;
    const Curvature curvature = weigh_view(at, lane, mode.root);
    mode.stationary = curvature.definite && !(at.moving[lane] > 0);
    mode.component = climbs.pair[i] % data.means.size[0];
    for (int e = 0; e < 9; ++e) mode.R[e] = at.view.R[e][lane];
    mode.log_scale = at.view.log_scale[lane];
    for (long j = 0; j < search.late.seen.m; ++j) mode.belief[j] = at.belief()[j][lane];
    mode.surprise = at.found.surprise[lane];
    mode.log_evidence = at.found.value[lane] + data.log_weights[mode.component] +
                        0.5 * (VIEW * LOG_TWO_PI - curvature.log_det);
    // A saddle, or a point on the way, counts only where no climb ends on a maximum.
    if (!mode.stationary) mode.log_evidence -= NO_MAXIMUM;
}

// Sort by evidence and leave out what was found before and what is negligible.
long rank(Combination& search, long count) {
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
    data.stationary[image] = false;
}

void store(const PosteriorData& data, long image, long rank, const Observed<double>& seen, const Mode& mode,
           const double* mean, Matrix<const double> covariance) {
    const long p = data.landmarks.size[2], d = 3 * p;
    data.mode_component[image][rank] = mode.component;
    data.mode_scale[image][rank] = exp(mode.log_scale);
    data.mode_log_evidence[image][rank] = mode.log_evidence;
    for (int e = 0; e < 9; ++e) data.mode_rotation[image][rank].data[e] = mode.R[e];
    for (long e = 0; e < d; ++e) data.mode_mean[image][rank].data[e] = mean[e];
    for (long e = 0; e < d; ++e)
        for (long f = 0; f < d; ++f) data.mode_covariance[image][rank][e][f] = covariance[e][f];
    for (long j = 0; j < p; ++j) data.mode_belief[image][rank][j] = NOT_A_NUMBER;
    for (long j = 0; j < seen.m; ++j)
        data.mode_belief[image][rank][seen.index[j]] = mode.belief[j];
}

// Mean and covariance of the mixture of the first `kept` modes.
void combine(const PosteriorData& data, long image, const Observed<double>& seen, Combination& search,
             long kept) {
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
    for (long j = 0; j < seen.m; ++j) data.belief[image][seen.index[j]] = 0;
    const Matrix<double> C = search.space.C;
    double before = 0;  // the share of the modes so far
    for (long i = 0; i < kept; ++i) {
        const Mode& mode = search.modes[search.order[i]];
        const double share = exp(mode.log_evidence - best) / total;
        const bool kept_alone = i < data.mode_component.size[1];
        describe(data, seen, mode, search.space, full || kept_alone, search.mean);
        const double step = share / (before + share), apart = before * step;
        // the mean moves by its share; what lies between joins the covariance
        for (long e = 0; e < d; ++e) {
            const double difference = search.mean[e] - mean[e];
            square_of[e] += share * C[e][e] + apart * square(difference);
            if (full)
                for (long f = 0; f < d; ++f)
                    full[e * d + f] += share * C[e][f] +
                                       apart * difference * (search.mean[f] - mean[f]);
        }
        for (long e = 0; e < d; ++e) {
            const long first = MIXED[e / p][0] * p + e % p, second = MIXED[e / p][1] * p + e % p;
            mixed[e] += share * C[first][second] +
                        apart * (search.mean[first] - mean[first]) * (search.mean[second] - mean[second]);
        }
        for (long e = 0; e < d; ++e) mean[e] += step * (search.mean[e] - mean[e]);
        before += share;
        surprise += share * mode.surprise;
        for (long j = 0; j < seen.m; ++j)
            data.belief[image][seen.index[j]] += share * mode.belief[j];
        if (kept_alone)
            store(data, image, i, seen, mode, search.mean, C);
    }
    for (long e = 0; e < d; ++e) square_of[e] = root(larger(square_of[e], 0.0));
    for (long e = 0; e < d; ++e)
        mixed[e] /= larger(square_of[MIXED[e / p][0] * p + e % p] * square_of[MIXED[e / p][1] * p + e % p], TINY);
    const Mode& first = search.modes[search.order[0]];
    for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = first.R[e];
    data.scale[image] = exp(first.log_scale);
    data.log_evidence[image] = best + log(total);
    data.surprise[image] = surprise;
    data.stationary[image] = first.stationary;
}

}  // namespace

void find_posterior(const PosteriorData& data, Range range) {
    Workspace workspace;
    Search search(workspace, data);
    Combination combination(workspace, data);
    for (long image = range.first; image < range.last; ++image) {
        data.rounds[image] = 0;
        for (long i = 0; i < data.mode_component.size[1]; ++i) {
            data.mode_component[image][i] = -1;
            data.mode_log_evidence[image][i] = -INFINITE;
        }
        const Observed<double>& seen = search.late.seen;
        search.late.seen.take(data, image);
        search.arrived.count = 0;
        if (seen.m >= 3) data.rounds[image] = climb_all(data, image, NEGLIGIBLE + LAPLACE, search);
        for (long i = 0; i < search.arrived.count; ++i)
            weigh(data, search, i, combination.modes[i]);
        const long kept = rank(combination, search.arrived.count);
        if (kept)
            combine(data, image, seen, combination, kept);
        else
            fail(data, image);
    }
}

const Exported<find_posterior> find_posterior_exported{"find_posterior"};

}  // namespace shapefit
