// Rows to columns and back, in registers.

// Lane i of the result is lane from(i) of a, or lane from(i) - W of b; -1: any value. `from` captures nothing.
template <class From, int... lane>
inline V shuffle(V a, V b, From, std::integer_sequence<int, lane...>) {
  return __builtin_shufflevector(a, b, From{}(lane)...);
}
template <class From>
inline V shuffle(V a, V b, From from) {
  return shuffle(a, b, from, std::make_integer_sequence<int, W>{});
}

// Column `column` of W contiguous rows of `width` values, as far as the first part + 1 vectors hold it.
template <int width, int column, int part = width - 1>
inline V column_of(const R* rows) {
  if constexpr (part == 0) {
    return load(rows);
  } else {
    return shuffle(column_of<width, column, part - 1>(rows), load(rows + W * part), [](int i) {
      const int at = width * i + column;
      return at / W == part ? W + at % W : part > 1 ? i : at < W ? at : -1;
    });
  }
}
template <int width, int... column>
inline void columns_of(const R* rows, V* out, std::integer_sequence<int, column...>) {
  ((out[column] = column_of<width, column>(rows)), ...);
}
template <int width>
inline void columns_of(const R* rows, V* out) {
  columns_of<width>(rows, out, std::make_integer_sequence<int, width>{});
}

// Vector k of the W contiguous rows of `width` values that have these columns.
template <int width, int k, int column = width - 1>
inline V of_columns(const V* columns) {
  if constexpr (column == 0)
    return shuffle(columns[0], columns[0], [](int lane) { return (W * k + lane) / width; });
  else
    return shuffle(of_columns<width, k, column - 1>(columns), columns[column], [](int lane) {
      const int at = W * k + lane;
      return at % width == column ? W + at / width : lane;
    });
}
// Inverse of columns_of.
template <int width, int k = 0>
inline void interleave(const V* columns, R* rows) {
  if constexpr (k < width) {
    store(rows + W * k, of_columns<width, k>(columns));
    interleave<width, k + 1>(columns, rows);
  }
}

// Transposes a W x W matrix; with half = 2, every 4 x 4 block of it by itself. Always inline, as rows_of is, so that it stays in registers.
template <int half = W / 2>
[[gnu::always_inline]] inline void transpose(V* rows) {
  if constexpr (half > 0) {
    for (int pair = 0; pair < W / 2; ++pair) {
      V &top = rows[pair / half * half * 2 + pair % half], &bottom = (&top)[half];
      const V a = top, b = bottom;
      top = shuffle(a, b, [](int lane) { return lane & half ? W + lane - half : lane; });
      bottom = shuffle(a, b, [](int lane) { return lane & half ? W + lane : lane + half; });
    }
    transpose<half / 2>(rows);
  }
}

// Writes W rows of kPaddedRow values, given their columns.
[[gnu::always_inline]] inline void rows_of(V* columns, R* rows) {
  for (int part = 0; part < kPaddedRow; part += W) {
    transpose(columns + part);
    for (int i = 0; i < W; ++i) store(rows + kPaddedRow * i + part, columns[part + i]);
  }
}

// Inverse of rows_of, for the first `used` columns.
template <int used = kPaddedRow>
[[gnu::always_inline]] inline void columns_of_rows(const R* rows, V* columns) {
  for (int part = 0; part < used; part += W) {
    for (int i = 0; i < W; ++i) columns[part + i] = load(rows + kPaddedRow * i + part);
    transpose(columns + part);
  }
}
