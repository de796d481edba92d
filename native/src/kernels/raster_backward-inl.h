// Stage 5: gradients of one tile. It walks the list front to back, as the forward pass did. The colour behind a Gaussian is the total
// minus the colour blended so far: there is no reverse walk and no division to recover T. Each (Gaussian, tile) pair writes to its own
// slot, so sums do not depend on the number of threads.
//
//   dL/dM_i     = alpha_i (T_i c_i.g - S_i / (1 - M_i alpha_i)),  S_i = g.(colour still to come)     (docs/methods.md)
//   dL/dalpha_i = M_i     (T_i c_i.g - S_i / (1 - M_i alpha_i))
//   dF/dM_i     = (1 - alpha_i T_N / (1 - M_i alpha_i)) / log(1 + N)

// Running values and image gradients of one block.
struct alignas(64) BackwardBlock {
  R rgb[3][kBlockPixels], depth[kBlockPixels], alpha[kBlockPixels];  // image gradients g

  R T[kBlockPixels];
  R behind[kBlockPixels];   // g.(everything not yet blended, background included)
  R mask[kBlockPixels];     // dL/dF divided by F's denominator
  R mask_T[kBlockPixels];   // the same times T_N
  R value[kBlockPixels];    // scenario A: F
  R to_come[kBlockPixels];  // scenarios: the sum behind of (M - F) alpha T w^2 (A), of M T (B)
};

inline void read_gradients(const Frame& f, const svrgs_image_grads& g, BlockPlace place, BackwardBlock& t) {
  if (g.rgb) read_block<3>(f, place, g.rgb, t.rgb);
  if (g.depth) read_block<1>(f, place, g.depth, &t.depth);
  if (g.alpha) read_block<1>(f, place, g.alpha, &t.alpha);
  if (g.mask && f.mask_kind != SVRGS_MASK_NONE) read_block<1>(f, place, g.mask, &t.mask);
  if (f.valid)
    for_rows(f, place, [&](int64_t at, int lane) {
      for (int x = 0; x < place.columns; ++x)
        if (!f.valid[at + x]) t.rgb[0][lane + x] = t.rgb[1][lane + x] = t.rgb[2][lane + x] = t.depth[lane + x] = t.alpha[lane + x] = t.mask[lane + x] = 0;
    });
}

// Initial values of the lanes from `h` on, given their image gradients and their stored state.
inline void start_lanes(const Frame& f, const svrgs_image_grads& g, const R* state, BackwardBlock& t, int h) {
  const V final_T = kept(state, kFinalT);
  V behind = load(t.alpha + h) * (broadcast(1) - final_T);
  for (int c = 0; c < 3; ++c) behind = fma(load(t.rgb[c] + h), fma(final_T, broadcast(static_cast<R>(f.background[c])), kept(state, Field(kRed + c))), behind);
  if (g.depth) behind = fma(load(t.depth + h), kept(state, kDepth), behind);
  store(t.T + h, broadcast(1));
  store(t.behind + h, behind);
  if (!g.mask || f.mask_kind == SVRGS_MASK_NONE) return;
  const V n = kept(state, kCount), d = load(t.mask + h);
  if (f.mask_kind == SVRGS_MASK_A) {
    const V F = spatial_mask(f, state);
    store(t.value + h, F);
    store(t.mask + h, keep(less(broadcast(0), n), d / kept(state, kSum0)));
    store(t.to_come + h, kept(state, kSum3) - F * kept(state, kSum2));
  } else {
    const V scaled = d * inverse_log(n);
    store(t.mask + h, scaled);
    store(t.mask_T + h, scaled * kept(state, kFullT));
    if (f.mask_kind == SVRGS_MASK_B) store(t.to_come + h, kept(state, kSum1));
  }
}

inline void start_backward(const Frame& f, const svrgs_image_grads& g, int64_t tile, BackwardBlock* blocks) {
  fetch_image<false>(f, tile, g.rgb, 3);
  fetch_image<false>(f, tile, g.mask, 1);
  __builtin_memset(static_cast<void*>(blocks), 0, sizeof(BackwardBlock) * kBlocks);
  R* const state = tile_state(f, tile);
  for_blocks(f, tile, [&](int b, BlockPlace place) {
    read_gradients(f, g, place, blocks[b]);
    for (int h = 0; h < kVectorsPerBlock; ++h) start_lanes(f, g, block_state(state, b, h), blocks[b], h * W);
  });
}

struct Sums {
  V g, gu, gv, guu, guv, gvv, red, green, blue, mask, depth, spatial;  // see enum Slot
};

struct WantedGradients {
  bool shape, colour, mask, depth, alpha, spatial;  // spatial: a gradient of F came in
};

// dF/dM_i of one hit, times dL/dF: the closed form (docs/methods.md), the self term alone, and paper scenarios A, B.
template <bool scenario>
inline V spatial_vjp(const Frame& f, BackwardBlock& t, int h, V alpha, V T, V inv, R mask, M counted) {
  const V d = load(t.mask + h), one = broadcast(1);
  if constexpr (!scenario) {
    const V share = f.mask_kind == SVRGS_MASK_SELF ? d * T : load(t.mask_T + h) * inv;
    return fnma(alpha, share, d);
  } else if (f.mask_kind == SVRGS_MASK_A) {
    const V weight = alpha * T, w = one / (weight + broadcast(static_cast<R>(f.eps_a))), F = load(t.value + h);
    const V to_come = add_if(counted, load(t.to_come + h), (F - broadcast(mask)) * weight * w * w), behind = to_come * inv;
    store(t.to_come + h, to_come);
    return d * fma(alpha, behind, w);
  } else {
    const V to_come = add_if(counted, load(t.to_come + h), -broadcast(mask) * T), behind = to_come * inv;
    store(t.to_come + h, to_come);
    return d * fma(alpha, behind, one - T);
  }
}

// Contributions of W pixels of a block to one Gaussian's gradients.
struct PixelGrads {
  V weight;      // of its colour; only the lanes in `live` count
  V alpha_grad;  // alpha dL/dalpha from the images of colour, depth and alpha
  V shape_grad;  // the same where alpha is not clamped, 0 elsewhere
  V spatial;     // dL/dM from F, where counted
  M live, counted;
};

// For the lanes from `h` on. shown: the Gaussian's mask is 1. depth_alpha: there may be gradients of depth or alpha.
template <bool spatial, bool scenario, bool depth_alpha>
[[gnu::always_inline]] inline PixelGrads pixel_grads(const Frame& f, const WantedGradients& want, BackwardBlock& t, const LocalGaussian& l, bool shown,
                                                     const Hit& e, int h) {
  const V one = broadcast(1), stop = broadcast(R(kStop));
  const V alpha = clamped(e.alpha), T = load(t.T + h);
  V image_grad = fma(broadcast(l.rgb[0]), load(t.rgb[0] + h), fma(broadcast(l.rgb[1]), load(t.rgb[1] + h), broadcast(l.rgb[2]) * load(t.rgb[2] + h)));
  if (depth_alpha && want.alpha) image_grad += load(t.alpha + h);
  if (depth_alpha && want.depth) image_grad = fma(broadcast(l.depth), load(t.depth + h), image_grad);
  PixelGrads p = {};
  V inv = one;
  M live;
  if (shown) {
    const V weight = keep(e.hit(), alpha * T), next = T - weight;  // the same operations as the forward pass
    live = at_least_in(e.hit(), next, stop);
    p.weight = weight, p.live = live;
    const V behind = fnma_if(live, weight, image_grad, load(t.behind + h));
    store(t.T + h, next);
    store(t.behind + h, behind);
    inv = reciprocal(one - alpha);
    p.alpha_grad = keep(live, alpha * fnma(behind, inv, T * image_grad));
  } else {
    live = at_least_in(e.hit(), T, stop);
    p.alpha_grad = keep(live, alpha * (T * image_grad - load(t.behind + h)));
  }
  if (shown) p.shape_grad = keep(less(e.alpha, broadcast(R(kAlphaMax))), p.alpha_grad);  // the clamp blocks the gradient
  if constexpr (spatial) {
    p.counted = f.full ? e.hit() : live;
    p.spatial = spatial_vjp<scenario>(f, t, h, alpha, T, inv, l.mask, p.counted);
  }
  return p;
}

// Adds one Gaussian's gradients over one block to its sums, one sum after the other for all pixels.
template <bool spatial, bool scenario, bool depth_alpha>
[[gnu::always_inline]] inline void accumulate(const Frame& f, const WantedGradients& want, BackwardBlock& t, const LocalGaussian& l, const BlockHits& hits,
                                              Sums& a) {
  const bool shown = drawn(l);
  PixelGrads p[kVectorsPerBlock];
  for (int h = 0; h < kVectorsPerBlock; ++h) p[h] = pixel_grads<spatial, scenario, depth_alpha>(f, want, t, l, shown, hits.part[h], h * W);
  for (int h = 0; h < kVectorsPerBlock; ++h) a.mask += p[h].alpha_grad;
  if constexpr (spatial)
    for (int h = 0; h < kVectorsPerBlock; ++h) a.spatial = add_if(p[h].counted, a.spatial, p[h].spatial);
  if (shown) {
    for (int h = 0; h < kVectorsPerBlock; ++h) a.red = fma_if(p[h].live, p[h].weight, load(t.rgb[0] + h * W), a.red);
    for (int h = 0; h < kVectorsPerBlock; ++h) a.green = fma_if(p[h].live, p[h].weight, load(t.rgb[1] + h * W), a.green);
    for (int h = 0; h < kVectorsPerBlock; ++h) a.blue = fma_if(p[h].live, p[h].weight, load(t.rgb[2] + h * W), a.blue);
    if (depth_alpha && want.depth)
      for (int h = 0; h < kVectorsPerBlock; ++h) a.depth = fma_if(p[h].live, p[h].weight, load(t.depth + h * W), a.depth);
  }
  if (!want.shape || !shown) return;
  for (int h = 0; h < kVectorsPerBlock; ++h) {
    const V g = p[h].shape_grad, u = hits.part[h].u, v = hits.part[h].v, gu = g * u, gv = g * v;
    a.g += g, a.gu += gu, a.gv += gv;
    a.guu = fma(gu, u, a.guu), a.guv = fma(gu, v, a.guv), a.gvv = fma(gv, v, a.gvv);
  }
}

// In the order of enum Slot.
inline void write_slot(const Sums& a, R* slot) {
  sum4(a.g, a.gu, a.gv, a.guu, slot);
  sum4(a.guv, a.gvv, a.red, a.green, slot + 4);
  sum4(a.blue, a.mask, a.depth, a.spatial, slot + 8);
}

inline WantedGradients wanted(const Frame& f, const svrgs_image_grads& in, const svrgs_grads& out, const svrgs_update* update) {
  WantedGradients w;
  w.shape = update || out.means || out.log_scales || out.quats || out.opacity_logits || out.means2d || out.camera;
  w.colour = (update || out.sh || out.means || out.camera) && in.rgb;
  w.mask = out.masks || (update && update->masks.param);
  w.depth = in.depth, w.alpha = in.alpha;
  w.spatial = in.mask && w.mask && f.mask_kind != SVRGS_MASK_NONE;
  return w;
}

// An entry of a tile's list that the forward pass marked.
struct Visit {
  LocalGaussian local;
  BlockMask blocks;
  R* slot;
};

constexpr int kVisitsAhead = 8;  // a visit takes longer than a look at a list entry: fewer ahead than in the forward pass

// Finds the next marked entry. At the end of the list it returns false and leaves `visit` as it is.
inline bool next_visit(const Frame& f, TileOrigin o, const TileEntry*& entry, const TileEntry* end, R* slots, Visit& visit) {
  for (; entry < end; ++entry) {
    if (entry + kVisitsAhead < end) {
      const TileEntry coming = entry[kVisitsAhead];
      __builtin_prefetch(&gaussian_of(f, coming));
      __builtin_prefetch(f.hits + coming.slot);
      __builtin_prefetch(slots + static_cast<int64_t>(coming.slot) * kSlotWidth, 1);
    }
    if (const BlockMask blocks = f.hits[entry->slot]) {
      visit = {to_local(gaussian_of(f, *entry), o), blocks, slots + static_cast<int64_t>(entry->slot) * kSlotWidth};
      ++entry;
      return true;
    }
  }
  return false;
}

// The first block of a tile. Not inlined on SSE, where a block is four vectors: inlining takes registers from the loop (stage 5: +1 to +3 %).
#if defined(SVRGS_HAVE_AVX2) || defined(SVRGS_HAVE_NEON)
inline
#else
[[gnu::noinline]]
#endif
    BlockHits evaluate_first(const Visit& visit, const AllLanes& lanes) {
  return evaluate_block(visit.local, lanes.block[__builtin_ctzll(visit.blocks)]);
}

template <bool spatial, bool scenario, bool depth_alpha>
void backward_tile_as(const Frame& f, const WantedGradients& want, const svrgs_image_grads& in, int64_t tile, R* slots) {
  const TileOrigin o = f.tile_origin(tile);
  const AllLanes& lanes = all_lanes();
  BackwardBlock blocks[kBlocks];
  start_backward(f, in, tile, blocks);
  const TileEntry *entry = f.entries + f.tile_begin[tile], *const end = f.entries + f.tile_begin[tile + 1];
  Visit visits[2];
  Visit *now = visits, *coming = visits + 1;
  if (!next_visit(f, o, entry, end, slots, *now)) return;
  *coming = *now;
  BlockHits ahead = evaluate_first(*now, lanes);
  for (bool more = true; more;) {
    more = next_visit(f, o, entry, end, slots, *coming);
    Sums a = {};
    for (BlockMask left = now->blocks; left;) {
      const int b = __builtin_ctzll(left);
      left &= left - 1;
      const BlockHits hits = ahead;  // of this block; those of the next one start now, beside what follows
      const Visit& next = left ? *now : *coming;
      ahead = evaluate_block(next.local, lanes.block[__builtin_ctzll(left ? left : coming->blocks)]);
      accumulate<spatial, scenario, depth_alpha>(f, want, blocks[b], now->local, hits, a);
    }
    write_slot(a, now->slot);
    std::swap(now, coming);
  }
}

template <bool spatial, bool scenario>
void backward_tile_with(const Frame& f, const WantedGradients& want, const svrgs_image_grads& in, int64_t tile, R* slots) {
  if (want.depth || want.alpha)
    backward_tile_as<spatial, scenario, true>(f, want, in, tile, slots);
  else
    backward_tile_as<spatial, scenario, false>(f, want, in, tile, slots);
}

void backward_tile(const Frame& f, const svrgs_image_grads& in, const svrgs_grads& out, const svrgs_update* update, int64_t tile, void* slots) {
  const WantedGradients want = wanted(f, in, out, update);
  R* const own = static_cast<R*>(slots);
  if (!want.spatial)
    backward_tile_with<false, false>(f, want, in, tile, own);
  else if (f.mask_kind == SVRGS_MASK_A || f.mask_kind == SVRGS_MASK_B)
    backward_tile_with<true, true>(f, want, in, tile, own);
  else
    backward_tile_with<true, false>(f, want, in, tile, own);
}
