#include "neighbours.h"

#include <algorithm>
#include <numeric>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int kMostWaiting = 64;  // most nodes that wait in a search

}  // namespace

PointTree::PointTree(const float* points, int64_t count) : order_(count), points_(3 * count) {
  std::iota(order_.begin(), order_.end(), 0u);
  nodes_.push_back({{}, {}, 0, count, -1});
  for (size_t first = 0; first < nodes_.size();) {  // level by level
    const size_t last = nodes_.size();
    int64_t next = static_cast<int64_t>(last);
    for (size_t i = first; i < last; ++i)
      if (nodes_[i].end - nodes_[i].begin > kLeaf) nodes_[i].left = next, next += 2;
    parallel_for(static_cast<int64_t>(last - first), [&](int64_t i) {
      Node& node = nodes_[first + i];
      bound(points, node);
      if (node.left >= 0) split(points, node);
    });
    nodes_.resize(next);
    for (size_t i = first; i < last; ++i) {
      const Node node = nodes_[i];
      if (node.left < 0) continue;
      const int64_t middle = (node.begin + node.end) / 2;
      nodes_[node.left] = {{}, {}, node.begin, middle, -1};
      nodes_[node.left + 1] = {{}, {}, middle, node.end, -1};
    }
    first = last;
  }
  for (size_t i = 0; i < nodes_.size(); ++i)
    if (nodes_[i].left < 0) leaves_.push_back(static_cast<int64_t>(i));
  std::sort(leaves_.begin(), leaves_.end(), [&](int64_t a, int64_t b) { return nodes_[a].begin < nodes_[b].begin; });
  parallel_blocks(count, 8192, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) std::copy_n(points + 3 * static_cast<int64_t>(order_[i]), 3, points_.data() + 3 * i);
  });
}

void PointTree::bound(const float* points, Node& node) const {
  std::fill_n(node.low, 3, 3e38f), std::fill_n(node.high, 3, -3e38f);
  for (int64_t i = node.begin; i < node.end; ++i)
    for (int k = 0; k < 3; ++k) {
      const float x = points[3 * static_cast<int64_t>(order_[i]) + k];
      node.low[k] = std::min(node.low[k], x), node.high[k] = std::max(node.high[k], x);
    }
}

// Puts the half of the points that is lower along the longest side of the box before the others.
void PointTree::split(const float* points, const Node& node) {
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (node.high[k] - node.low[k] > node.high[axis] - node.low[axis]) axis = k;
  const auto along = [&](uint32_t row) { return points[3 * static_cast<int64_t>(row) + axis]; };
  const auto less = [&](uint32_t a, uint32_t b) { return along(a) != along(b) ? along(a) < along(b) : a < b; };
  std::nth_element(order_.begin() + node.begin, order_.begin() + (node.begin + node.end) / 2, order_.begin() + node.end, less);
}

void PointTree::scan(const Node& leaf, int64_t place, Nearest& nearest) const {
  const float* const at = points_.data() + 3 * place;
  for (int64_t i = leaf.begin; i < leaf.end; ++i) {
    const float* const p = points_.data() + 3 * i;
    const float x = p[0] - at[0], y = p[1] - at[1], z = p[2] - at[2], square = x * x + y * y + z * z;
    if (square < nearest.reach() && i != place) nearest.add(square, static_cast<uint32_t>(i));
  }
}

void PointTree::search(int64_t own, int64_t place, Nearest& nearest) const {
  const float* const at = points_.data() + 3 * place;
  const auto gap = [&](int64_t number) {
    const Node& node = nodes_[number];
    float sum = 0;
    for (int k = 0; k < 3; ++k) {
      const float outside = std::max({node.low[k] - at[k], at[k] - node.high[k], 0.0f});
      sum += outside * outside;
    }
    return sum;
  };
  struct Waiting {
    int64_t node;
    float square;
  } waiting[kMostWaiting];
  int count = 0;
  scan(nodes_[own], place, nearest);
  waiting[count++] = {0, 0};
  while (count) {
    const Waiting next = waiting[--count];
    if (next.square >= nearest.reach()) continue;
    const Node& node = nodes_[next.node];
    if (node.left < 0) {
      if (next.node != own) scan(node, place, nearest);
      continue;
    }
    const float left = gap(node.left), right = gap(node.left + 1);
    const bool right_first = right < left;
    waiting[count++] = right_first ? Waiting{node.left, left} : Waiting{node.left + 1, right};
    waiting[count++] = right_first ? Waiting{node.left + 1, right} : Waiting{node.left, left};
  }
}

}  // namespace svrgs
