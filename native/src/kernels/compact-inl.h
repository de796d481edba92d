// Sets of lanes, one bit a lane: compress, expand and list the lanes of a set; sets of rows.

// Which of the W rows from `base` on are named by ids[0 .. known), a bit each. The ids ascend, and ids[0] is one of these rows.
inline uint32_t rows_from(uint32_t base, const uint32_t* ids, int64_t known) {
  [[maybe_unused]] constexpr uint32_t all = (1ull << W) - 1;
#if defined(SVRGS_HAVE_AVX512)
  if (known >= W)
    return all & static_cast<uint32_t>(_mm512_reduce_or_epi32(
                     _mm512_sllv_epi32(_mm512_set1_epi32(1), _mm512_sub_epi32(_mm512_loadu_si512(ids), _mm512_set1_epi32(static_cast<int>(base))))));
#elif defined(SVRGS_HAVE_AVX2)
  if (known >= W) {
    const __m256i place = _mm256_sub_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(ids)), _mm256_set1_epi32(static_cast<int>(base)));
    const __m256i bit = _mm256_sllv_epi32(_mm256_set1_epi32(1), place);
    const __m128i half = _mm_or_si128(_mm256_castsi256_si128(bit), _mm256_extracti128_si256(bit, 1));
    const uint64_t pair = static_cast<uint64_t>(_mm_extract_epi64(half, 0) | _mm_extract_epi64(half, 1));
    return all & static_cast<uint32_t>(pair | pair >> 32);
  }
#endif
  uint32_t rows = 0;
  for (int64_t i = 0; i < known && ids[i] - base < W; ++i) rows |= 1u << (ids[i] - base);
  return rows;
}

template <int width>
struct RowBits {  // the row, as a bit, of each value of W rows
  IntR bit[W * width] = {};
  constexpr RowBits() {
    for (int i = 0; i < W * width; ++i) bit[i] = IntR(1) << i / width;
  }
};
template <int width>
constexpr RowBits<width> kRowBits;

// The lanes of vector k that hold values of the rows in the set `rows`; W contiguous rows are `width` vectors.
template <int width>
inline M lanes_of_rows(uint32_t rows, int k) {
  I bit;
  __builtin_memcpy(&bit, kRowBits<width>.bit + W * k, sizeof bit);
#if defined(SVRGS_HAVE_AVX512)
  return _mm512_test_epi32_mask((__m512i)bit, _mm512_set1_epi32(static_cast<int>(rows)));
#else
  return (bit & (I{} + static_cast<IntR>(rows))) != 0;
#endif
}

#if defined(SVRGS_HAVE_AVX2) && !defined(SVRGS_HAVE_AVX512)
struct SetRanks {  // how many set bits of every 8 lie below each bit, a byte each
  uint64_t ranks[256] = {};
  constexpr SetRanks() {
    for (int set = 0; set < 256; ++set)
      for (int i = 0, n = 0; i < 8; n += set >> i++ & 1) ranks[set] |= static_cast<uint64_t>(n) << 8 * i;
  }
};
constexpr SetRanks kSetRanks;
#endif

// Expands contiguous values: the first goes to the lane of the lowest set bit, and so on; other lanes are 0.
inline V spread(uint32_t set, const R* packed) {
  [[maybe_unused]] const uint32_t first = (1u << __builtin_popcount(set)) - 1;  // as many lanes
#if defined(SVRGS_HAVE_AVX512)
  return _mm512_maskz_expand_ps(static_cast<M>(set), _mm512_maskz_loadu_ps(static_cast<M>(first), packed));
#elif defined(SVRGS_HAVE_AVX2)
  const __m256i from = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(kSetRanks.ranks[set])));
  return keep(lanes_of(set), _mm256_permutevar8x32_ps(_mm256_maskload_ps(packed, (__m256i)lanes_of(first)), from));
#else
  V v = {};
  for (; set; set &= set - 1) v[__builtin_ctz(set)] = *packed++;
  return v;
#endif
}

#if !defined(SVRGS_HAVE_AVX512)
using Bytes = std::conditional_t<W == 8, uint64_t, uint32_t>;
struct SetBits {  // the positions of the set bits of every W bits, a byte each; how many they are
  Bytes positions[1 << W] = {};
  uint8_t count[1 << W] = {};
  constexpr SetBits() {
    for (int set = 0; set < 1 << W; ++set)
      for (int i = 0; i < W; ++i)
        if (set >> i & 1) positions[set] |= static_cast<Bytes>(i) << 8 * count[set]++;
  }
};
constexpr SetBits kSetBits;
#endif

#if defined(SVRGS_HAVE_NEON)
struct SetBytes {  // for every set: the bytes of its lanes, then 255, which the table lookup turns into 0
  uint8_t bytes[1 << W][16];
  constexpr SetBytes() : bytes() {
    for (int set = 0; set < 1 << W; ++set) {
      int n = 0;
      for (int byte = 0; byte < 16; ++byte)
        if (set >> byte / 4 & 1) bytes[set][n++] = static_cast<uint8_t>(byte);
      while (n < 16) bytes[set][n++] = 255;
    }
  }
};
alignas(16) constexpr SetBytes kSetBytes;
inline uint8x16_t to_front(uint32_t set, uint8x16_t lanes) { return vqtbl1q_u8(lanes, vld1q_u8(kSetBytes.bytes[set])); }
#endif

// The number of lanes in `set`.
inline int lane_count(uint32_t set) {
#if defined(SVRGS_HAVE_AVX2)
  return __builtin_popcount(set);
#else
  return kSetBits.count[set];
#endif
}

// Appends first + i to the list for each set bit i of `set`. Returns the new count. May write 16 bytes from list + count on.
inline int append_lanes(uint8_t* list, int count, int first, uint32_t set) {
#if defined(SVRGS_HAVE_AVX512)
  const __m512i lanes = _mm512_add_epi32(_mm512_set1_epi32(first), _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
  const __m128i bytes = _mm512_cvtepi32_epi8(_mm512_maskz_compress_epi32(static_cast<__mmask16>(set), lanes));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(list + count), bytes);
#else
  if constexpr (W == 1) {
    list[count] = static_cast<uint8_t>(first);
  } else {
    const Bytes bytes = kSetBits.positions[set] + static_cast<Bytes>(0x0101010101010101) * static_cast<Bytes>(first);
    __builtin_memcpy(list + count, &bytes, sizeof bytes);
  }
#endif
  return count + lane_count(set);
}

// Compresses: writes the lanes of `set` to `to`, contiguously. May write W values, of which only these are defined.
inline void pack(uint32_t set, V v, R* to) {
#if defined(SVRGS_HAVE_AVX512)
  store(to, _mm512_maskz_compress_ps(static_cast<M>(set), v));
#elif defined(SVRGS_HAVE_AVX2)
  const __m256i from = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(kSetBits.positions[set])));
  store(to, _mm256_permutevar8x32_ps(v, from));
#elif defined(SVRGS_HAVE_NEON)
  store(to, (V)to_front(set, (uint8x16_t)v));
#else
  for (; set; set &= set - 1) *to++ = v[__builtin_ctz(set)];
#endif
}

// The same for the values first + lane.
inline void pack_lanes(uint32_t set, uint32_t first, uint32_t* to) {
#if defined(SVRGS_HAVE_AVX512)
  const __m512i lanes = _mm512_add_epi32(_mm512_set1_epi32(static_cast<int>(first)), _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
  _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(static_cast<M>(set), lanes));
#elif defined(SVRGS_HAVE_NEON)
  vst1q_u32(to, (uint32x4_t)to_front(set, (uint8x16_t)(vdupq_n_u32(first) + uint32x4_t{0, 1, 2, 3})));
#else
  for (; set; set &= set - 1) *to++ = first + static_cast<uint32_t>(__builtin_ctz(set));
#endif
}
