// Stage 5: gradients of one tile. It walks the list front to back as the forward pass did, and gets what lies behind a
// Gaussian as (total - what was blended so far): no reverse walk, no division to recover T. Each (Gaussian, tile) pair
// writes its own slot, so sums do not depend on the number of threads.
//
//   dL/dM_i     = alpha_i (T_i c_i.g - S_i / (1 - M_i alpha_i)),  S_i = g.(colour still to come)     (design.md section 3)
//   dL/dalpha_i = M_i     (T_i c_i.g - S_i / (1 - M_i alpha_i))
//   dF/dM_i     = (1 - alpha_i T_N / (1 - M_i alpha_i)) / log(1 + N)

struct BackwardTile {
  V T[kBlocks][kSub], behind[kBlocks][kSub];  // behind: g.(everything not yet blended, background included)
  V red[kBlocks][kSub], green[kBlocks][kSub], blue[kBlocks][kSub], depth[kBlocks][kSub], alpha[kBlocks][kSub];  // g
  V mask[kBlocks][kSub];      // dL/dF over F's denominator
  V full_T[kBlocks][kSub];    // T_N
  V value[kBlocks][kSub];     // F, scenario A
  V to_come[kBlocks][kSub];   // scenarios: sum behind of (M - F) alpha T w^2 (A), of M T (B)
};

inline void start_pixel(const Frame& f, const svrgs_image_grads& g, int64_t at, const R* pixel, BackwardTile& t, int b, int lane) {
  const int h = lane / W, i = lane % W;
  const auto field = [&](Field k) { return pixel[k * kBlockPixels]; };
  R behind = 0;
  if (g.rgb) {
    const R* d = static_cast<const R*>(g.rgb) + 3 * at;
    t.red[b][h][i] = d[0], t.green[b][h][i] = d[1], t.blue[b][h][i] = d[2];
    for (int c = 0; c < 3; ++c) behind += d[c] * (field(Field(kRed + c)) + field(kFinalT) * static_cast<R>(f.background[c]));
  }
  if (g.depth) {
    t.depth[b][h][i] = static_cast<const R*>(g.depth)[at];
    behind += t.depth[b][h][i] * field(kDepth);
  }
  if (g.alpha) {
    t.alpha[b][h][i] = static_cast<const R*>(g.alpha)[at];
    behind += t.alpha[b][h][i] * (1 - field(kFinalT));
  }
  t.T[b][h][i] = 1;
  t.behind[b][h][i] = behind;
  if (!g.mask || f.mask_kind == kMaskNone) return;
  const R d = static_cast<const R*>(g.mask)[at], F = spatial_mask(f, pixel), n = field(kCount);
  t.full_T[b][h][i] = field(kFullT);
  t.value[b][h][i] = F;
  if (f.mask_kind == kMaskA) {
    t.mask[b][h][i] = n > 0 ? d / field(kSum0) : R(0);
    t.to_come[b][h][i] = field(kSum3) - F * field(kSum2);
  } else {
    t.mask[b][h][i] = d * inverse_log(n);
    t.to_come[b][h][i] = field(kSum1);
  }
}

inline void start_backward(const Frame& f, const svrgs_image_grads& g, int64_t tile, BackwardTile& t) {
  __builtin_memset(&t, 0, sizeof t);
  const R* state = tile_state(f, tile);
  for_pixels(f, tile, [&](int64_t at, int block, int lane) {
    start_pixel(f, g, at, state + block * kFields * kBlockPixels + lane, t, block, lane);
  });
}

struct Sums {
  V v, vx, vy, vxx, vxy, vyy, red, green, blue, mask, depth, spatial;  // mask: from the colours; spatial: from F
};

struct Wanted {
  bool shape, colour, mask, depth, spatial;  // spatial: a gradient of F came in
};

// dF/dM_i and dF/dalpha_i of one hit, times dL/dF: design.md closed form, the self term alone, and paper scenarios A, B.
struct SpatialGrads {
  V mask, alpha;
};

template <bool scenario>
inline SpatialGrads spatial_vjp(const Frame& f, BackwardTile& t, int b, int h, V alpha, V T, V inv, R mask, M counted) {
  const V d = t.mask[b][h], one = splat(1);
  if constexpr (!scenario) {
    if (f.mask_kind == kMaskSelf) return {d * fnma(alpha, T, one), -splat(mask) * d * T};
    const V share = t.full_T[b][h] * inv;
    return {d * fnma(alpha, share, one), -splat(mask) * d * share};
  } else if (f.mask_kind == kMaskA) {
    const V weight = alpha * T, w = one / (weight + splat(static_cast<R>(f.eps_a))), F = t.value[b][h];
    t.to_come[b][h] = add_if(counted, t.to_come[b][h], (F - splat(mask)) * weight * w * w);
    const V behind = t.to_come[b][h] * inv;
    return {d * fma(alpha, behind, w), d * (splat(mask) * behind - (splat(mask) - F) * T * w * w)};
  } else {
    t.to_come[b][h] = add_if(counted, t.to_come[b][h], -splat(mask) * T);
    const V behind = t.to_come[b][h] * inv;
    return {d * fma(alpha, behind, one - T), splat(mask) * d * behind};
  }
}

template <bool scenario>
inline void accumulate_block(const Frame& f, const Wanted& want, BackwardTile& t, const Local& l, const Lanes& lanes, int b, Sums& a) {
  const Splat<R>& s = *l.s;
  const V one = splat(1), stop = splat(R(kStop));
  for (int h = 0; h < kSub; ++h) {
    const Hit e = evaluate(l, lanes, b, h);
    if (!any(e.hit)) continue;
    const V T = t.T[b][h];
    V through = fma(splat(s.rgb[0]), t.red[b][h], fma(splat(s.rgb[1]), t.green[b][h], fma(splat(s.rgb[2]), t.blue[b][h], t.alpha[b][h])));
    if (want.depth) through = fma(splat(s.depth), t.depth[b][h], through);
    V inv = one, v;
    M live;
    if (s.mask != 0) {
      const V weight = keep(e.hit, e.alpha * T), next = T - weight;  // the same operations as the forward pass
      live = both(e.hit, at_least(next, stop));
      const V w = keep(live, weight);
      t.T[b][h] = next;
      t.behind[b][h] = fnma(w, through, t.behind[b][h]);
      inv = one / (one - e.alpha);
      v = keep(live, e.alpha * fnma(t.behind[b][h], inv, T * through));
      if (want.colour) {
        a.red = fma(w, t.red[b][h], a.red);
        a.green = fma(w, t.green[b][h], a.green);
        a.blue = fma(w, t.blue[b][h], a.blue);
      }
      if (want.depth) a.depth = fma(w, t.depth[b][h], a.depth);
      a.mask += v;
      v = keep(e.free, v);
    } else {
      live = both(e.hit, at_least(T, stop));
      a.mask += keep(live, e.alpha * fnma(one, t.behind[b][h], T * through));
      v = splat(0);
    }
    if (want.spatial) {
      const M counted = f.full ? e.hit : live;
      const SpatialGrads d = spatial_vjp<scenario>(f, t, b, h, e.alpha, T, inv, s.mask, counted);
      a.spatial += keep(counted, d.mask);
      if (f.mask_to_shape) v += keep(both(counted, e.free), e.alpha * d.alpha);
    }
    if (!want.shape) continue;
    const V vx = v * e.dx, vy = v * e.dy;
    a.v += v, a.vx += vx, a.vy += vy;
    a.vxx = fma(vx, e.dx, a.vxx), a.vxy = fma(vx, e.dy, a.vxy), a.vyy = fma(vy, e.dy, a.vyy);
  }
}

// In the order of enum Slot.
inline void write_slot(const Sums& a, R* slot) {
  sum4(a.v, a.vx, a.vy, a.vxx, slot);
  sum4(a.vxy, a.vyy, a.red, a.green, slot + 4);
  sum4(a.blue, a.mask, a.depth, a.spatial, slot + 8);
}

inline Wanted wanted(const svrgs_image_grads& in, const svrgs_grads& out) {
  Wanted w;
  w.shape = out.means || out.log_scales || out.quats || out.opacity_logits || out.means2d;
  w.colour = (out.sh || out.means) && in.rgb;
  w.mask = out.masks;
  w.depth = in.depth;
  w.spatial = in.mask && (w.mask || w.shape);
  return w;
}

template <bool scenario>
void backward_tile_as(const Frame& f, const svrgs_image_grads& in, const svrgs_grads& out, int64_t tile, R* slots) {
  const Lanes lanes = block_lanes();
  const TileOrigin o = tile_origin(f, tile);
  Wanted want = wanted(in, out);
  want.spatial = want.spatial && f.mask_kind != kMaskNone;
  BackwardTile t;
  start_backward(f, in, tile, t);
  const TileEntry* const end = f.entries + f.tile_begin[tile + 1];
  for (const TileEntry* e = f.entries + f.tile_begin[tile]; e < end; ++e) {
    const TileEntry entry = *e;
    if (e + kAhead < end) {
      prefetch_splat(f, e + kAhead, end);
      __builtin_prefetch(f.hits + e[kAhead].slot);
      __builtin_prefetch(slots + static_cast<int64_t>(e[kAhead].slot) * kSlotWidth, 1);
    }
    uint32_t blocks_left = f.hits[entry.slot];
    if (!blocks_left) continue;
    const Local l = localise(f, entry.splat, o.x, o.y);
    Sums a = {};
    for (; blocks_left; blocks_left &= blocks_left - 1) accumulate_block<scenario>(f, want, t, l, lanes, __builtin_ctz(blocks_left), a);
    write_slot(a, slots + static_cast<int64_t>(entry.slot) * kSlotWidth);
  }
}

void backward_tile(const Frame& f, const svrgs_image_grads& in, const svrgs_grads& out, int64_t tile, void* slots) {
  if (f.mask_kind == kMaskA || f.mask_kind == kMaskB)
    backward_tile_as<true>(f, in, out, tile, static_cast<R*>(slots));
  else
    backward_tile_as<false>(f, in, out, tile, static_cast<R*>(slots));
}

// Per-Gaussian statistics of one tile: slot = sum of alpha T, its maximum, pixels blended.
void scores_tile(const Frame& f, int64_t tile, void* slots) {
  const Lanes lanes = block_lanes();
  const TileOrigin o = tile_origin(f, tile);
  ForwardTile t;
  start_tile(f, o, lanes, t);
  const V stop = splat(R(kStop));
  for (int64_t e = f.tile_begin[tile]; e < f.tile_begin[tile + 1]; ++e) {
    const TileEntry entry = f.entries[e];
    const Local l = localise(f, entry.splat, o.x, o.y);
    V total = splat(0), best = splat(0), pixels = splat(0);
    if (l.s->mask == 0) continue;
    for (uint32_t blocks_left = f.hits[entry.slot]; blocks_left; blocks_left &= blocks_left - 1) {
      const int b = __builtin_ctz(blocks_left);
      for (int h = 0; h < kSub; ++h) {
        const Hit hit = evaluate(l, lanes, b, h);
        const V weight = keep(hit.hit, hit.alpha * t.T[b][h]), next = t.T[b][h] - weight;
        const M live = both(hit.hit, at_least(next, stop));
        t.T[b][h] = next;
        total += keep(live, weight);
        best = max(best, keep(live, weight));
        pixels = add_if(live, pixels, splat(1));
      }
    }
    R* slot = static_cast<R*>(slots) + static_cast<int64_t>(entry.slot) * kSlotWidth;
    slot[0] = sum(total), slot[1] = largest(best), slot[2] = sum(pixels);
  }
}
