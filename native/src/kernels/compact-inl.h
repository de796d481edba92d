// Sets of lanes, one bit a lane: compress and expand the lanes of a set; sets of rows; sets from the bits of bytes, and lists from sets.

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

struct SetBits {  // the positions of the set bits of every 8 bits, a byte each; how many they are
  uint64_t positions[256] = {};
  uint8_t count[256] = {};
  constexpr SetBits() {
    for (int set = 0; set < 256; ++set)
      for (int i = 0; i < 8; ++i)
        if (set >> i & 1) positions[set] |= static_cast<uint64_t>(i) << 8 * count[set]++;
  }
};
constexpr SetBits kSetBits;

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

// Writes W whole numbers of 0 to 255 as bytes.
inline void store_bytes(uint8_t* to, I v) {
#if defined(SVRGS_HAVE_AVX512)
  _mm_storeu_si128(reinterpret_cast<__m128i*>(to), _mm512_cvtepi32_epi8((__m512i)v));
#elif defined(SVRGS_HAVE_AVX2)
  const __m128i words = _mm_packs_epi32(_mm256_castsi256_si128((__m256i)v), _mm256_extracti128_si256((__m256i)v, 1));
  _mm_storel_epi64(reinterpret_cast<__m128i*>(to), _mm_packus_epi16(words, words));
#else
  for (int i = 0; i < W; ++i) to[i] = static_cast<uint8_t>(v[i]);
#endif
}

// Bit `bit` of 64 bytes.
inline uint64_t bit_of_bytes(const uint8_t* bytes, int bit) {
#if defined(SVRGS_HAVE_AVX512)
  return _mm512_test_epi8_mask(_mm512_loadu_si512(bytes), _mm512_set1_epi8(static_cast<char>(1 << bit)));
#elif defined(SVRGS_HAVE_AVX2)
  const __m128i up = _mm_cvtsi32_si128(7 - bit);
  const auto half = [&](const uint8_t* from) {
    return static_cast<uint32_t>(_mm256_movemask_epi8(_mm256_sll_epi16(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(from)), up)));
  };
  return half(bytes) | static_cast<uint64_t>(half(bytes + 32)) << 32;
#else
  uint64_t set = 0;
  for (int i = 0; i < 8; ++i) {
    uint64_t eight;
    __builtin_memcpy(&eight, bytes + 8 * i, sizeof eight);
    set |= ((eight >> bit & 0x0101010101010101) * 0x0102040810204080 >> 56) << 8 * i;  // the product has bit 8 k in its bit 56 + k
  }
  return set;
#endif
}

#if defined(SVRGS_HAVE_AVX512)
// list_bits() by an instruction that not every processor with AVX-512 has.
[[gnu::target("avx512vbmi2")]] inline int list_bits_vbmi2(const uint64_t* sets, int count, uint8_t* list) {
  __m512i places = _mm512_setr_epi64(0x0706050403020100, 0x0f0e0d0c0b0a0908, 0x1716151413121110, 0x1f1e1d1c1b1a1918, 0x2726252423222120, 0x2f2e2d2c2b2a2928,
                                     0x3736353433323130, 0x3f3e3d3c3b3a3938);
  int listed = 0;
  for (int i = 0; i < count; ++i, places = _mm512_add_epi8(places, _mm512_set1_epi8(64))) {
    _mm512_storeu_si512(list + listed, _mm512_maskz_compress_epi8(sets[i], places));
    listed += __builtin_popcountll(sets[i]);
  }
  return listed;
}
#endif

// Lists the places of the set bits of count <= 4 sets of 64. Returns how many. May write 64 bytes from there on.
inline int list_bits(const uint64_t* sets, int count, uint8_t* list) {
#if defined(SVRGS_HAVE_AVX512)
  static const bool vbmi2 = has_vbmi2();
  if (vbmi2) return list_bits_vbmi2(sets, count, list);
#endif
  int listed = 0;
  const auto* eights = reinterpret_cast<const uint8_t*>(sets);
  uint64_t first = 0;
  for (const uint8_t* const end = eights + 8 * count; eights < end; ++eights, first += 0x0808080808080808) {
    const uint64_t bytes = kSetBits.positions[*eights] + first;
    __builtin_memcpy(list + listed, &bytes, sizeof bytes);
    listed += lane_count(*eights);
  }
  return listed;
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
