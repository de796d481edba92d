#include "decimate.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <memory>
#include <vector>

#include "constants.h"
#include "depth_sort.h"
#include "neighbours.h"
#include "pool.h"
#include "principal_axes.h"

namespace svrgs {
namespace {

constexpr int kNeighbours = 12;       // nearest Gaussians that are looked at in the beginning
constexpr int kKept = 8;              // of these, the cheapest to merge with are kept
constexpr double kOffered = 0.5;      // of the offers, those that a round may take: the cheapest
constexpr float kMergeFactor = 0.1f;  // a merge costs this share of the change of the pictures, a removal all of it: merges come first
constexpr double kBlurUsed = 0.2;     // pixels^2, added to the variances on the screen
constexpr double kLargestLog = 12;    // of a scale in pixels, either way
constexpr float kFarthest = 1e6f;     // pixels from the middle, along each axis
constexpr double kLeastTransmittance = 1e-3;
constexpr double kCalibration = 10;  // most by which the removal error of a merge differs from its square, either way
constexpr int64_t kRowGrain = 256;   // rows of a task
constexpr int64_t kLeafGrain = 16;   // leaves of a task
constexpr uint32_t kGone = ~0u;

struct Candidates {  // those that a Gaussian may merge with
  uint32_t ids[kKept];
  float costs[kKept];
  int count = 0;

  void add(uint32_t id, float cost) {
    int place = count;
    if (count < kKept)
      ++count;
    else if (place = static_cast<int>(std::max_element(costs, costs + kKept) - costs); costs[place] <= cost)
      return;
    ids[place] = id, costs[place] = cost;
  }
};

struct Pairs {  // of one task: their costs are computed together. It allocates nothing, because a task must not throw.
  static constexpr int64_t kMost = std::max(2 * kKept * kRowGrain, kNeighbours * kLeafGrain * PointTree::kLeaf);
  uint32_t a[kMost], b[kMost];
  float costs[kMost];
  int64_t count = 0;

  void add(uint32_t x, uint32_t y) { a[count] = x, b[count++] = y; }
  bool has_since(int64_t first, uint32_t y) const { return std::find(b + first, b + count, y) != b + count; }
  void compute(const Kernels& kernels, const MergeScene& scene) { kernels.merge_costs(scene, a, b, count, costs); }
};

struct Operation {
  float cost;
  uint32_t a, b;  // places; b: kGone for a removal, else above a
};

float coordinate(const svrgs_decimation& in, int64_t row, int axis) {
  const double x = (static_cast<double>(in.means[3 * row + axis]) - in.middle[axis]) / in.unit;
  return std::isfinite(x) ? std::clamp(static_cast<float>(x), -kFarthest, kFarthest) : 0;
}

std::vector<float> coordinates(const svrgs_decimation& in) {
  std::vector<float> points(3 * in.count);
  parallel_blocks(in.count, kRowGrain, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i)
      for (int axis = 0; axis < 3; ++axis) points[3 * i + axis] = coordinate(in, i, axis);
  });
  return points;
}

// R diag(scales^2) R^T in units of a pixel. False if a value is not finite.
bool covariance(const svrgs_decimation& in, int64_t row, float cov[6]) {
  double q[4], squares[3], length = 0;
  for (int k = 0; k < 4; ++k) q[k] = static_cast<double>(in.quats[4 * row + k]), length += q[k] * q[k];
  for (int k = 0; k < 3; ++k)
    squares[k] = std::exp(2 * std::clamp(static_cast<double>(in.log_scales[3 * row + k]) - std::log(in.unit), -kLargestLog, kLargestLog));
  for (double& x : q) x /= std::sqrt(length);
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  const double m[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                          {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                          {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
  bool finite = true;
  for (int i = 0, at = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j, ++at) {
      cov[at] = static_cast<float>(m[i][0] * m[j][0] * squares[0] + m[i][1] * m[j][1] * squares[1] + m[i][2] * m[j][2] * squares[2]);
      finite = finite && std::isfinite(cov[at]);
    }
  return finite;
}

// The squared error of leaving out the picture of a Gaussian, without occlusion.
double square_of(const MergeRow& r) {
  double colour = static_cast<double>(r.sh_square);
  for (const float c : r.colour) colour += static_cast<double>(c) * static_cast<double>(c);
  return 0.5 * static_cast<double>(r.area) * static_cast<double>(r.amplitude) * static_cast<double>(r.amplitude) * colour * static_cast<double>(r.density);
}

float sh_square(const float* row, int coefficients) {
  double sum = 0;
  for (int k = 3; k < 3 * coefficients; ++k) sum += static_cast<double>(row[k]) * static_cast<double>(row[k]);
  return static_cast<float>(sum) * kShMean;
}

class Decimation {
 public:
  Decimation(const Kernels& kernels, const svrgs_decimation& in, const svrgs_merges& out)
      : kernels_(kernels),
        in_(in),
        out_(out),
        tree_(coordinates(in).data(), in.count),
        rows_(in.count),
        lists_(in.count),
        forward_(in.count),
        partner_(in.count),
        covariances_(std::make_unique_for_overwrite<float[]>(6 * (in.count - in.least))) {
    scene_ = {rows_.data(), in.count, in.sh_coefficients, in.sh, out.sh};
    parallel_blocks(in.count, kRowGrain, [&](int64_t begin, int64_t end) {
      for (int64_t place = begin; place < end; ++place) fill(place, rows_[place]);
      kernels_.merge_areas(rows_.data(), begin, end);
    });
    parallel_blocks(tree_.leaves(), kLeafGrain, [&](int64_t begin, int64_t end) { list(begin, end); });
    active_.resize(in.count);
    for (int64_t i = 0; i < in.count; ++i) active_[i] = forward_[i] = static_cast<uint32_t>(i);
  }

  bool run(const int32_t* cancel) {
    while (alive() > in_.least) {
      if (cancel && __atomic_load_n(cancel, __ATOMIC_RELAXED)) return false;
      choose();
      merge();
      relist();
    }
    return true;
  }

  void finish(int64_t& steps, int64_t& merges) const {
    const double unit = std::log(in_.unit);
    parallel_blocks(merges_, kRowGrain, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        double cov[6];
        std::copy_n(covariances_.get() + 6 * i, 6, cov);
        principal_axes(cov, out_.log_scales + 3 * i, out_.quats + 4 * i);
        for (int k = 0; k < 3; ++k) out_.log_scales[3 * i + k] += static_cast<float>(unit);
      }
    });
    steps = steps_, merges = merges_;
  }

 private:
  int64_t alive() const { return static_cast<int64_t>(active_.size()); }
  void fill(int64_t place, MergeRow& row) const;
  void list(int64_t begin, int64_t end);
  void choose();
  Operation cheapest(uint32_t place) const;
  void merge();
  void store(const Operation&, MergeRow& made) const;
  void relist();
  void add_pairs(uint32_t place, Pairs& pairs);
  uint32_t now(uint32_t place) const;

  const Kernels& kernels_;
  const svrgs_decimation& in_;
  const svrgs_merges& out_;
  PointTree tree_;
  std::vector<MergeRow> rows_;     // by place; a merge takes the place of its first Gaussian
  std::vector<Candidates> lists_;  // likewise
  std::vector<uint32_t> forward_;  // by place: where the Gaussian is now; its own place, that of the merge it is part of, or kGone if it was removed
  std::vector<uint32_t> partner_;  // by place, in this round. 0: unchanged. kGone: removed, or merged into another place. Else: the place merged into this one
  std::vector<uint32_t> active_;   // places, ascending
  std::vector<Operation> chosen_;  // in this round
  std::unique_ptr<float[]> covariances_;
  MergeScene scene_ = {};
  int64_t steps_ = 0, merges_ = 0;
};

void Decimation::fill(int64_t place, MergeRow& row) const {
  const int64_t id = tree_.order()[place];
  const double* const seen = in_.visibility + SVRGS_VISIBILITY * id;
  row.row = static_cast<uint32_t>(id);
  for (int axis = 0; axis < 3; ++axis) row.mean[axis] = coordinate(in_, id, axis);
  const float* const sh = in_.sh + id * 3 * in_.sh_coefficients;
  row.sh_square = sh_square(sh, in_.sh_coefficients);
  const double opacity = 1 / (1 + std::exp(-static_cast<double>(in_.opacity_logits[id])));
  const double transmittance = seen[2] > 0 ? std::max(seen[1] / seen[2], kLeastTransmittance) : kLeastTransmittance;
  const bool usable = covariance(in_, id, row.cov) && std::isfinite(opacity) && std::isfinite(row.sh_square) && seen[0] > 0;
  if (!usable) std::copy_n(std::initializer_list<float>{1, 0, 0, 1, 0, 1}.begin(), 6, row.cov), row.sh_square = 0;
  row.transmittance = static_cast<float>(transmittance);
  row.amplitude = usable ? static_cast<float>(opacity * transmittance) : 0;
  row.contribution = usable ? static_cast<float>(seen[0]) : 0;
  row.removal = usable ? static_cast<float>(seen[3]) : 0;
  for (int c = 0; c < 3; ++c) row.colour[c] = usable ? static_cast<float>(seen[4 + c] / seen[0]) : 0;
  row.blur = in_.antialiased || !usable ? 0 : static_cast<float>(kBlurUsed * seen[7] / (seen[8] * in_.unit * in_.unit));
}

void Decimation::list(int64_t begin, int64_t end) {
  Pairs pairs;
  for (int64_t leaf = begin; leaf < end; ++leaf)
    tree_.for_neighbours(leaf, kNeighbours, [&](int64_t place, const Neighbour* found, int count) {
      for (int k = 0; k < count && rows_[place].contribution > 0; ++k)  // Gaussians that no view sees are only ever removed
        if (rows_[found[k].place].contribution > 0) pairs.add(static_cast<uint32_t>(place), found[k].place);
    });
  pairs.compute(kernels_, scene_);
  for (int64_t k = 0; k < pairs.count; ++k) lists_[pairs.a[k]].add(pairs.b[k], pairs.costs[k]);
}

Operation Decimation::cheapest(uint32_t place) const {
  const Candidates& list = lists_[place];
  Operation best = {rows_[place].removal, place, kGone};
  for (int k = 0; k < list.count; ++k) {
    const float cost = kMergeFactor * list.costs[k];
    if (cost < best.cost || (cost == best.cost && list.ids[k] < best.b && best.b != kGone)) best = {cost, place, list.ids[k]};
  }
  if (best.b < best.a) std::swap(best.a, best.b);
  return best;
}

// The cheapest operations of all Gaussians that have none in common.
void Decimation::choose() {
  const int64_t count = alive(), most = count - in_.least, offered = std::max<int64_t>(1, static_cast<int64_t>(kOffered * static_cast<double>(count)));
  const auto keys = std::make_unique_for_overwrite<Keyed[]>(2 * count);
  const auto offers = std::make_unique_for_overwrite<Operation[]>(count);
  parallel_blocks(count, kRowGrain, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      offers[i] = cheapest(active_[i]);
      keys[i] = {std::bit_cast<uint32_t>(std::max(offers[i].cost, 0.0f)), static_cast<uint32_t>(i)};
    }
  });
  const Keyed* const sorted = sort_by_depth(keys.get(), keys.get() + count, count);
  chosen_.clear();
  for (int64_t i = 0; i < offered && static_cast<int64_t>(chosen_.size()) < most; ++i) {
    const Operation& offer = offers[sorted[i].place];
    if (partner_[offer.a] || (offer.b != kGone && partner_[offer.b])) continue;
    partner_[offer.a] = offer.b;  // kGone for a removal
    if (offer.b != kGone) partner_[offer.b] = kGone;
    chosen_.push_back(offer);
  }
}

// Writes the operations and puts the results of merges in the places of their first Gaussians.
void Decimation::merge() {
  std::vector<uint32_t> a, b;
  std::vector<int64_t> of;
  for (const Operation& op : chosen_) {
    out_.a[steps_] = rows_[op.a].row, out_.b[steps_] = op.b == kGone ? kGone : rows_[op.b].row;
    out_.costs[steps_++] = op.cost;
    if (op.b == kGone) {
      forward_[op.a] = kGone;
    } else {
      a.push_back(op.a), b.push_back(op.b), of.push_back(&op - chosen_.data());
    }
  }
  std::vector<MergeRow> made(a.size());
  const int64_t first = merges_;
  merges_ += static_cast<int64_t>(a.size());
  parallel_blocks(static_cast<int64_t>(a.size()), kRowGrain, [&](int64_t begin, int64_t end) {
    kernels_.merge_rows(scene_, a.data() + begin, b.data() + begin, end - begin, made.data() + begin);
    for (int64_t k = begin; k < end; ++k) {
      made[k].row = static_cast<uint32_t>(in_.count + first + k);
      store(chosen_[of[k]], made[k]);
    }
  });
  for (size_t k = 0; k < a.size(); ++k) rows_[a[k]] = made[k], forward_[b[k]] = a[k];
}

// Completes the result of a merge and writes it to the output.
void Decimation::store(const Operation& op, MergeRow& made) const {
  const MergeRow &a = rows_[op.a], &b = rows_[op.b];
  const int64_t at = made.row - in_.count;
  const int width = 3 * in_.sh_coefficients;
  const float *const x = scene_.sh_row(a.row), *const y = scene_.sh_row(b.row), both = a.contribution + b.contribution;
  const float share = both > 0 ? a.contribution / both : 0.5f;
  float* const sh = out_.sh + at * width;
  for (int k = 0; k < width; ++k) sh[k] = share * x[k] + (1 - share) * y[k];
  made.sh_square = sh_square(sh, in_.sh_coefficients);
  made.error = a.error + b.error + std::max(op.cost / kMergeFactor - static_cast<float>(kErrorShare) * (a.error + b.error), 0.0f);
  const double measured = static_cast<double>(a.removal + b.removal), foreseen = std::max(square_of(a) + square_of(b), 1e-20);
  made.removal = static_cast<float>(square_of(made) * std::clamp(measured / foreseen, 1 / kCalibration, kCalibration));
  for (int k = 0; k < 3; ++k) out_.means[3 * at + k] = static_cast<float>(static_cast<double>(made.mean[k]) * in_.unit + in_.middle[k]);
  if (std::isnan(made.amplitude)) made.amplitude = 0;  // of areas beyond all floats
  const double opacity = std::clamp(static_cast<double>(made.amplitude / made.transmittance), 1e-6, kAlphaMax);
  out_.opacity_logits[at] = static_cast<float>(std::log(opacity / (1 - opacity)));
  std::copy_n(made.cov, 6, covariances_.get() + 6 * at);
}

uint32_t Decimation::now(uint32_t place) const {
  while (place != kGone && forward_[place] != place) place = forward_[place];
  return place;
}

// The lists of Gaussians that were merged in this round, or may merge with one that was.
void Decimation::relist() {
  std::erase_if(active_, [&](uint32_t place) { return forward_[place] != place; });
  parallel_blocks(alive(), kRowGrain, [&](int64_t begin, int64_t end) {
    Pairs pairs;
    for (int64_t i = begin; i < end; ++i) add_pairs(active_[i], pairs);
    pairs.compute(kernels_, scene_);
    for (int64_t k = 0; k < pairs.count; ++k) lists_[pairs.a[k]].add(pairs.b[k], pairs.costs[k]);
  });
  for (const Operation& op : chosen_) {
    partner_[op.a] = 0;
    if (op.b != kGone) partner_[op.b] = 0;
  }
}

// Leaves the candidates in the list of a Gaussian whose costs still hold, and adds the others to the pairs, each once.
void Decimation::add_pairs(uint32_t place, Pairs& pairs) {
  const int64_t first = pairs.count;
  const bool is_new = partner_[place] != 0;
  Candidates& own = lists_[place];
  Candidates unchanged;
  for (int k = 0; k < own.count; ++k)
    if (!is_new && !partner_[own.ids[k]]) unchanged.add(own.ids[k], own.costs[k]);
  if (!is_new && unchanged.count == own.count) return;
  const auto add_changed = [&](const Candidates& list) {
    for (int k = 0; k < list.count; ++k) {
      const uint32_t other = now(list.ids[k]);
      const bool known = std::find(unchanged.ids, unchanged.ids + unchanged.count, other) != unchanged.ids + unchanged.count;
      if (other == kGone || other == place || known || pairs.has_since(first, other)) continue;
      pairs.add(place, other);
    }
  };
  add_changed(own);
  if (is_new) add_changed(lists_[partner_[place]]);
  own = unchanged;
}

}  // namespace

bool decimate(const Kernels& kernels, const svrgs_decimation& in, const int32_t* cancel, const svrgs_merges& out, int64_t& steps, int64_t& merges) {
  Decimation decimation(kernels, in, out);
  if (!decimation.run(cancel)) return false;
  decimation.finish(steps, merges);
  return true;
}

}  // namespace svrgs
