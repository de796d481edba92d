// The gradients of an image against those of a photograph, in full size, half and a quarter (svrgs_gradient_loss in svrgs.h).
//
// A row of errors has a pixel more at both ends, equal to the outermost one, and the first and the last row count as their own neighbours: there is no
// gradient across the border.

inline R* errors_of(const GradientSize& s, int64_t y) { return static_cast<R*>(s.errors) + y * s.stride() + 3; }

inline void repeat_ends(R* errors, int64_t values) {
  for (int c = 0; c < 3; ++c) errors[c - 3] = errors[c], errors[values + c] = errors[values - 3 + c];
}

// The errors of rows [begin, end) of the full size.
void error_rows(const void* image, const void* target, const GradientSize& s, int64_t begin, int64_t end) {
  const int64_t row = 3 * s.width;
  for (int64_t y = begin; y < end; ++y) {
    const R *a = static_cast<const R*>(image) + y * row, *b = static_cast<const R*>(target) + y * row;
    R* const to = errors_of(s, y);
    for (int64_t i = 0; i < row; ++i) to[i] = a[i] - b[i];
    repeat_ends(to, row);
  }
}

// Rows [begin, end) of half the size: means of 2 x 2 pixels.
void halved_rows(const GradientSize& from, const GradientSize& s, int64_t begin, int64_t end) {
  for (int64_t y = begin; y < end; ++y) {
    const R *a = errors_of(from, 2 * y), *b = errors_of(from, 2 * y + 1);
    R* const to = errors_of(s, y);
    for (int64_t x = 0; x < s.width; ++x)
      for (int c = 0; c < 3; ++c) to[3 * x + c] = R(0.25) * (a[6 * x + c] + a[6 * x + 3 + c] + b[6 * x + c] + b[6 * x + 3 + c]);
    repeat_ends(to, 3 * s.width);
  }
}

inline V signed_step(V g, V difference, V step) {
  g = add_if(less(broadcast(0), difference), g, step);
  return add_if(less(difference, broadcast(0)), g, -step);
}

// Adds the gradient of rows [begin, end) to s.grad, with what the half size, if there is one, gives. Returns their part of the value.
double gradient_loss_rows(const GradientSize& s, const GradientSize* half, double weight, int64_t begin, int64_t end) {
  const int64_t row = 3 * s.width;
  const V unit_down = broadcast(static_cast<R>(s.down)), unit_across = broadcast(static_cast<R>(s.across));
  const V down = broadcast(static_cast<R>(weight * s.down)), across = broadcast(static_cast<R>(weight * s.across));
  V lanes;
  for (int k = 0; k < W; ++k) lanes[k] = static_cast<R>(k);
  D total = {};
  for (int64_t y = begin; y < end; ++y) {
    const R *const at = errors_of(s, y), *const above = errors_of(s, std::max<int64_t>(y - 1, 0)), *const below = errors_of(s, std::min(y + 1, s.height - 1));
    R* const grad = static_cast<R*>(s.grad) + y * row;
    for (int64_t i = 0; i < row; i += W) {
      const V e = load(at + i), lower = load(below + i) - e, right = load(at + i + 3) - e;
      V g = signed_step(broadcast(0), e - load(above + i), down);
      g = signed_step(g, lower, -down);
      g = signed_step(g, e - load(at + i - 3), across);
      g = signed_step(g, right, -across);
      const V value = fma(unit_down, magnitude(lower), unit_across * magnitude(right));
      total += __builtin_convertvector(keep(less(lanes, broadcast(static_cast<R>(row - i))), value), D);
      if (i + W <= row)
        store(grad + i, load(grad + i) + g);
      else
        for (int k = 0; i + k < row; ++k) grad[i + k] += g[k];
    }
    if (!half || y / 2 >= half->height) continue;
    const R* const from = static_cast<const R*>(half->grad) + y / 2 * 3 * half->width;
    for (int64_t x = 0; x < half->width; ++x)
      for (int c = 0; c < 3; ++c) grad[6 * x + c] += R(0.25) * from[3 * x + c], grad[6 * x + 3 + c] += R(0.25) * from[3 * x + c];
  }
  double sum = 0;
  for (int k = 0; k < W; ++k) sum += total[k];
  return sum;
}
