// The posterior over shape and view of each image: one mode after another, and all of them combined.
#include "../base/small_matrices.hpp"
#include "description.hpp"

namespace shapefit {
namespace {

constexpr double SAME_VIEW = 1e-2;    // rotations as close are one mode (Frobenius norm)
constexpr double NO_MAXIMUM = 50;     // subtracted from the log evidence of a point that is no maximum
constexpr double NEGLIGIBLE = 6;      // modes this far below the best in log evidence are left out
constexpr double LAPLACE = 1;         // by which integrating over the view may change their order
constexpr int MIXED[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // coordinates of a landmark

struct Mode {
    long component;
    Rotation R;
    double log_scale;
    double log_evidence;
    double squared_mahalanobis;
    bool stationary;            // the gradient is 0, and every direction leads down
    double root[VIEW * VIEW];   // W with W^T W = (H + I)^-1, the covariance of the view
    double* inlier_probability;  // (m,)
};

// The modes of an image; `order` begins with those that count, the best first.
struct Modes {
    Modes(Workspace& workspace, long most, long p)
        : modes(workspace.zeros<Mode>(most)), order(workspace.zeros<long>(most)) {
        for (long i = 0; i < most; ++i) modes[i].inlier_probability = workspace.zeros<double>(p);
    }

    const Mode& operator[](long i) const { return modes[order[i]]; }

    Mode* modes;
    long* order;
};

// The root of the covariance of the view, (H + I)^-1, where no direction is less than flat; returns
// log det (H + I), and whether H is positive definite.
struct Curvature {
    double log_det;
    bool definite;
};

Curvature weigh_view(const Ascent<Doubles>& at, long lane, double* root_of) {
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

// The point on which ascent i ended, with its evidence.
void weigh(const PosteriorData& data, const Search& search, long i, Mode& mode) {
    const Ascents<Doubles>& ascents = search.arrived;
    Ascent<Doubles>& at = ascents[i];
    const long lane = i % WIDTH;
    const Curvature curvature = weigh_view(at, lane, mode.root);
    mode.stationary = curvature.definite && !(at.moving[lane] > 0);
    mode.component = ascents.pair[i] % data.means.size[0];
    for (int e = 0; e < 9; ++e) mode.R[e] = at.view.R[e][lane];
    mode.log_scale = at.view.log_scale[lane];
    for (long j = 0; j < search.late.observed.m; ++j) mode.inlier_probability[j] = at.inlier_probability[j][lane];
    mode.squared_mahalanobis = at.found.squared_mahalanobis[lane];
    mode.log_evidence = at.found.value[lane] + data.log_weights[mode.component] +
                        0.5 * (VIEW * LOG_TWO_PI - curvature.log_det);
    // A saddle, or a point on the way, counts only where no ascent ends on a maximum.
    if (!mode.stationary) mode.log_evidence -= NO_MAXIMUM;
}

// Sort by evidence and leave out what was found before and what is negligible.
long rank(Modes& search, long count) {
    for (long i = 0; i < count; ++i) {
        long place = i;
        for (; place > 0 && search.modes[search.order[place - 1]].log_evidence <
                                search.modes[i].log_evidence;
             --place)
            search.order[place] = search.order[place - 1];
        search.order[place] = i;
    }
    long retained = 0;
    for (long i = 0; i < count; ++i) {
        const Mode& mode = search.modes[search.order[i]];
        if (mode.log_evidence < search.modes[search.order[0]].log_evidence - NEGLIGIBLE) break;
        bool known = false;
        for (long o = 0; o < retained && !known; ++o) {
            const Mode& other = search.modes[search.order[o]];
            double distance = 0;
            for (int e = 0; e < 9; ++e) distance += square(mode.R[e] - other.R[e]);
            known = other.component == mode.component && distance < SAME_VIEW * SAME_VIEW;
        }
        if (!known) search.order[retained++] = search.order[i];
    }
    return retained;
}

void fill(double* x, long n, double value) {
    for (long e = 0; e < n; ++e) x[e] = value;
}

// Mean and covariance of a mixture, from one mode to the next: deviations and MIXED correlations, and
// the whole covariance where there is room for it.
class Mixture {
  public:
    Mixture(const PosteriorData& data, long image)
        : p_(data.landmarks.size[2]),
          d_(3 * p_),
          mean_(data.mean[image].data),
          squares_(data.deviation[image].data),
          mixed_(data.correlation[image].data),
          whole_(data.covariance.size[0] ? data.covariance[image].data : nullptr) {}

    bool is_whole() const { return whole_; }

    void set_all(double value) {
        fill(mean_, d_, value);
        fill(squares_, d_, value);
        fill(mixed_, d_, value);
        if (whole_) fill(whole_, d_ * d_, value);
    }

    // The mean moves by the mode's share; what lies between joins the covariance. mean(e), C(e, f).
    template <class Mean, class Covariance>
    void add(double share, const Mean& mean, const Covariance& C) {
        const double step = share / (before_ + share), distance = before_ * step;
        const auto entry = [&](long e, long f) {
            return share * C(e, f) + distance * (mean(e) - mean_[e]) * (mean(f) - mean_[f]);
        };
        for (long e = 0; e < d_; ++e) squares_[e] += entry(e, e);
        for (long e = 0; e < d_; ++e) mixed_[e] += entry(first(e), second(e));
        for (long e = 0; whole_ && e < d_; ++e)
            for (long f = 0; f < d_; ++f) whole_[e * d_ + f] += entry(e, f);
        for (long e = 0; e < d_; ++e) mean_[e] += step * (mean(e) - mean_[e]);
        before_ += share;
    }

    // Squares become deviations, and covariances of MIXED correlations.
    void finish() {
        for (long e = 0; e < d_; ++e) squares_[e] = root(larger(squares_[e], 0.0));
        for (long e = 0; e < d_; ++e)
            mixed_[e] /= larger(squares_[first(e)] * squares_[second(e)], TINY);
    }

  private:
    long first(long e) const { return MIXED[e / p_][0] * p_ + e % p_; }
    long second(long e) const { return MIXED[e / p_][1] * p_ + e % p_; }

    const long p_, d_;
    double *mean_, *squares_, *mixed_, *whole_;
    double before_ = 0;  // the share of the modes so far
};

void fail(const PosteriorData& data, long image) {
    Mixture(data, image).set_all(NOT_A_NUMBER);
    fill(data.inlier_probability[image].data, data.landmarks.size[2], NOT_A_NUMBER);
    fill(data.rotation[image].data, 9, NOT_A_NUMBER);
    data.scale[image] = data.log_evidence[image] = data.squared_mahalanobis[image] = NOT_A_NUMBER;
    data.stationary[image] = false;
}

template <class Mean, class Covariance>
void store(const PosteriorData& data, long image, long rank, const Observed<double>& observed, const Mode& mode,
           const Mean& mean, const Covariance& covariance) {
    const long p = data.landmarks.size[2], d = 3 * p;
    data.mode_component[image][rank] = mode.component;
    data.mode_scale[image][rank] = exp(mode.log_scale);
    data.mode_log_evidence[image][rank] = mode.log_evidence;
    mode.R.write(data.mode_rotation[image][rank].data);
    for (long e = 0; e < d; ++e) data.mode_mean[image][rank].data[e] = mean(e);
    for (long e = 0; e < d; ++e)
        for (long f = 0; f < d; ++f) data.mode_covariance[image][rank][e][f] = covariance(e, f);
    const Vector<double> inlier_probability = data.mode_inlier_probability[image][rank];
    fill(inlier_probability.data, p, NOT_A_NUMBER);
    for (long j = 0; j < observed.m; ++j) inlier_probability[observed.index[j]] = mode.inlier_probability[j];
}

// Describe the modes from `first` on, one a lane; lanes without one stand for the last.
void describe_modes(const Modes& modes, long first, long retained, bool whole, Side<Doubles>& side,
                    Description& description) {
    LaneView<Doubles> view;
    Doubles root_of[VIEW * VIEW];
    Places<Doubles> of;
    for (int lane = 0; lane < WIDTH; ++lane) {
        const Mode& mode = modes[first + lane < retained ? first + lane : retained - 1];
        of[lane] = mode.component;
        for (int e = 0; e < 9; ++e) view.R[e][lane] = mode.R[e];
        view.log_scale[lane] = mode.log_scale;
        for (int e = 0; e < VIEW * VIEW; ++e) root_of[e][lane] = mode.root[e];
        for (long j = 0; j < side.observed.m; ++j) side.space.inlier_probability[j][lane] = mode.inlier_probability[j];
    }
    fetch(of, side);
    describe(side, of, view, side.space.inlier_probability, root_of, whole, description);
}

// The mixture of the first `retained` modes, by their evidence.
void combine(const PosteriorData& data, long image, const Modes& modes, long retained, Side<Doubles>& side,
             Description& description) {
    const Observed<double>& observed = side.observed;
    const long p = data.landmarks.size[2];
    const double best = modes[0].log_evidence;
    double total = 0, squared_mahalanobis = 0;
    for (long i = 0; i < retained; ++i) total += exp(modes[i].log_evidence - best);
    const Vector<double> inlier_probability = data.inlier_probability[image];
    fill(inlier_probability.data, p, NOT_A_NUMBER);
    for (long j = 0; j < observed.m; ++j) inlier_probability[observed.index[j]] = 0;
    Mixture mixture(data, image);
    mixture.set_all(0);
    for (long i = 0; i < retained; ++i) {
        const Mode& mode = modes[i];
        const long lane = i % WIDTH, most_stored = data.mode_component.size[1];
        const double share = exp(mode.log_evidence - best) / total;
        if (lane == 0)
            describe_modes(modes, i, retained, mixture.is_whole() || i < most_stored, side, description);
        const auto row = [=](long e) { return 3 * (e % p) + e / p; };
        const auto mean = [&](long e) { return description.mean[row(e)][lane]; };
        const auto C = [&](long e, long f) { return description.C[row(e) * description.d + row(f)][lane]; };
        mixture.add(share, mean, C);
        squared_mahalanobis += share * mode.squared_mahalanobis;
        for (long j = 0; j < observed.m; ++j) inlier_probability[observed.index[j]] += share * mode.inlier_probability[j];
        if (i < most_stored) store(data, image, i, observed, mode, mean, C);
    }
    mixture.finish();
    modes[0].R.write(data.rotation[image].data);
    data.scale[image] = exp(modes[0].log_scale);
    data.log_evidence[image] = best + log(total);
    data.squared_mahalanobis[image] = squared_mahalanobis;
    data.stationary[image] = modes[0].stationary;
}

}  // namespace

// Ascent from every start under every component; weigh the maxima by their evidence, the view
// integrated out by Laplace's approximation; mean and covariance of the mixture of those that count.
void find_posterior(const PosteriorData& data, Range range) {
    const long p = data.landmarks.size[2];
    Workspace workspace;
    Search search(workspace, data);
    Description description(workspace, p);
    Modes modes(workspace, data.starts.size[1] * data.means.size[0], p);
    const Observed<double>& observed = search.late.observed;
    for (long image = range.first; image < range.last; ++image) {
        data.rounds[image] = 0;
        for (long i = 0; i < data.mode_component.size[1]; ++i) {
            data.mode_component[image][i] = -1;
            data.mode_log_evidence[image][i] = -INFINITE;
        }
        search.late.observed.take(data, image);
        search.arrived.count = 0;
        if (observed.m >= 3) data.rounds[image] = ascend_all(data, image, NEGLIGIBLE + LAPLACE, search);
        for (long i = 0; i < search.arrived.count; ++i) weigh(data, search, i, modes.modes[i]);
        const long retained = rank(modes, search.arrived.count);
        if (retained)
            combine(data, image, modes, retained, search.late, description);
        else
            fail(data, image);
    }
}

const Exported<find_posterior> find_posterior_exported{"find_posterior"};

}  // namespace shapefit
