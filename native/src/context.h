// One renderer: grow-only buffers and the order of the stages.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "frame.h"
#include "kernels.h"
#include "svrgs.h"
#include "tiles.h"

namespace svrgs {

// Memory that only grows and is not initialised; contents are lost when it grows.
class Buffer {
 public:
  template <class T>
  T* reserve(int64_t count) {
    const size_t bytes = static_cast<size_t>(count) * sizeof(T) + 64;
    if (bytes > size_) {
      data_.reset();
      const size_t grown = bytes + bytes / 4;
      data_.reset(static_cast<char*>(::operator new(grown, std::align_val_t{128})));
      size_ = grown;
    }
    return reinterpret_cast<T*>(data_.get());
  }

 private:
  struct Free {
    void operator()(char* p) const { ::operator delete(p, std::align_val_t{128}); }
  };
  std::unique_ptr<char, Free> data_;
  size_t size_ = 0;
};

struct Failure {  // thrown inside the library only; api.cc turns it into a status
  svrgs_status status;
  std::string sentence;
};

class Context {
 public:
  explicit Context(const Kernels& kernels) : kernels_(kernels) {}

  void forward(const svrgs_scene&, const svrgs_camera&, const svrgs_options&, const svrgs_images&);
  // Writes gradients to `out` and, if there is an update, makes an Adam step. Returns the rows that the step left alone.
  int64_t backward(const svrgs_image_grads&, const svrgs_grads& out, const svrgs_update*);
  void scores(const uint8_t* valid, const Scores&);  // valid: optional, the pixels that count; not in a view that has such pixels
  void moments(double* rows);
  void removal(const void* residuals, double* cost);
  void visibility(double* sums);
  void slopes(double* sums);
  void dominance(double* pixels);
  int64_t adam(const svrgs_adam_settings&, void* param, void* moments, const void* grad, const uint32_t* ids, int64_t rows, int width);
  void loss(const void* image, const void* target, int height, int width, double l1_weight, double ssim_weight, void* grad, double values[2]);
  double mask_loss(const void* mask, int64_t count, double weight, void* grad);

  const uint32_t* visible() const { return frame_.visible; }
  int64_t visible_count() const { return frame_.visible_count; }
  svrgs_work work(bool count_pixels) const;
  const double* stage_seconds() const { return seconds_; }
  bool holds_view() const { return holds_view_; }
  bool holds_depth() const { return frame_.want_depth; }
  bool holds_limit() const { return frame_.depth_limit; }
  bool holds_valid() const { return frame_.valid; }

 private:
  void set_frame(const svrgs_scene&, const svrgs_camera&, const svrgs_options&, const svrgs_images&);
  void project();
  void find_tiles(int64_t max_pairs);
  void choose_bins();
  void fill_bins();
  void leave_out(const uint8_t* frozen);
  void list_and_blend(const svrgs_images&);
  bool cancelled() const;
  char* slots_of(int values);
  int64_t sum_before(int64_t ProjectionCounts::* what);
  void loss_tiles(const void* image, const void* target, int height, int width, double l1_weight, double ssim_weight, void* grad, double values[2]);
  template <class F>
  void timed(svrgs_stage stage, F&& run);
  template <class F>
  void add_sums(double* out, F&& run);
  template <class F>
  void for_each_tile(F&& run) const;  // run(tile), in any order, until the cancel flag is set

  const Kernels& kernels_;
  Frame frame_ = {};
  const int32_t* cancel_ = nullptr;
  int64_t pairs_ = 0;
  std::vector<ProjectionCounts> chunk_counts_, before_;  // by chunk of projection: of it, and of all before it
  std::vector<BinPart> parts_;                           // likewise
  TileLists lists_ = {};
  bool holds_view_ = false;
  bool scored_ = false;  // slots_ hold the scores of all pixels of the view
  double seconds_[SVRGS_STAGES] = {};
  Buffer gaussians_, rects_, tiles_, spans_, ids_, depth_keys_, visible_, places_, bin_begin_, tile_begin_, entries_, counts_, listed_, hits_, state_;
  Buffer slots_;  // of the pixels' sums; before, where tiles are listed
  Buffer loss_scratch_, tile_values_;
};

}  // namespace svrgs
