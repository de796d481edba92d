// The nearest points of a point cloud: a k-d tree whose leaves are runs of an order of the points.
#pragma once
#include <cstdint>
#include <vector>

namespace svrgs {

struct Neighbour {
  float square;    // of the distance
  uint32_t place;  // in the order of the tree
};

class PointTree {
 public:
  // points (count, 3), finite.
  PointTree(const float* points, int64_t count);

  // The points in an order in which near ones are near each other: rows of `points`.
  const std::vector<uint32_t>& order() const { return order_; }
  static constexpr int64_t kLeaf = 16;  // most points of a leaf

  int64_t leaves() const { return static_cast<int64_t>(leaves_.size()); }
  // Calls found(place, neighbours, how many) for each point of a leaf, with its `most` nearest other points, nearest first.
  template <class F>
  void for_neighbours(int64_t leaf, int most, F&& found) const;

 private:
  struct Node {
    float low[3], high[3];
    int64_t begin, end;  // places
    int64_t left;        // the other child follows it; -1: a leaf
  };
  struct Nearest;  // those found so far

  void bound(const float* points, Node& node) const;
  void split(const float* points, const Node& node);
  void scan(const Node& leaf, int64_t place, Nearest& nearest) const;
  void search(int64_t own, int64_t place, Nearest& nearest) const;

  static constexpr int kMost = 32;  // neighbours
  std::vector<uint32_t> order_;
  std::vector<Node> nodes_;
  std::vector<int64_t> leaves_;  // nodes, in the order of their places
  std::vector<float> points_;    // (count, 3), by place
};

struct PointTree::Nearest {
  explicit Nearest(int wanted) : most(wanted) {}
  int most, count = 0;
  Neighbour found[kMost];
  float reach() const { return count < most ? 3e38f : found[most - 1].square; }
  void add(float square, uint32_t place) {
    int k = count < most ? count++ : most - 1;
    for (; k > 0 && found[k - 1].square > square; --k) found[k] = found[k - 1];
    found[k] = {square, place};
  }
};

template <class F>
void PointTree::for_neighbours(int64_t leaf, int most, F&& found) const {
  const Node& own = nodes_[leaves_[leaf]];
  for (int64_t place = own.begin; place < own.end; ++place) {
    Nearest nearest(most);
    search(leaves_[leaf], place, nearest);
    found(place, nearest.found, nearest.count);
  }
}

}  // namespace svrgs
