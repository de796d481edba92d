/* SVR-GS native core: the manual.

   Masked Gaussian rasterisation with the spatial mask F of the SVR-GS paper, its gradients, the image loss and the
   optimiser step. Conventions (docs/conventions.md): COLMAP camera frame (x right, y down, z forward), world-to-camera
   matrices row-major, pixel centres at k + 0.5, quaternions w x y z of any positive length, raw (logit, log) parameters
   as 3DGS stores them, images row-major (H, W) or (H, W, 3).

   Rules: the caller allocates every output; "optional" pointers may be NULL, and then their output is not computed;
   inputs and outputs must not overlap. Arrays marked `real` are float, or double in a context of level SVRGS_DOUBLE.
   Functions that can fail return an SVRGS_ status; svrgs_last_error() then has one sentence on why, per thread.
   No function throws. Nothing is global except the thread pool. */
#ifndef SVRGS_H
#define SVRGS_H

#include <stdint.h>

#if defined(_WIN32)
#define SVRGS_API __declspec(dllexport)
#else
#define SVRGS_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define SVRGS_INTERFACE_VERSION 26

typedef void real; /* float or double, by the context's level */

enum svrgs_status { SVRGS_OK = 0, SVRGS_INVALID = 1, SVRGS_NO_MEMORY = 2, SVRGS_CANCELLED = 3, SVRGS_TOO_LARGE = 4 };

/* SIMD levels, each a separate compilation of the same kernels. SCALAR is the reference for the others. */
enum svrgs_level { SVRGS_SCALAR = 0, SVRGS_BASELINE = 1, SVRGS_AVX2 = 2, SVRGS_AVX512 = 3, SVRGS_DOUBLE = 4, SVRGS_NEON = 5, SVRGS_LEVELS };

/* How the spatial mask F and its gradient are computed. The gradient of F reaches the masks M only. SVR: paper Eq. 5 and 9. SELF: F as in
   SVR, the gradient from the self term alone, 1 - alpha_i T_i. A, B: the paper's scenarios. EVEN: F and dF/dM as in SVR, but a Gaussian's
   sum over its pixels is scaled to a footprint of SVRGS_EVEN_AREA pixels, so that large and small Gaussians have comparable gradients.
   NONE computes neither F nor its counts. */
enum svrgs_mask_kind {
  SVRGS_MASK_NONE = 0,
  SVRGS_MASK_SVR = 1,
  SVRGS_MASK_SELF = 2,
  SVRGS_MASK_A = 3,
  SVRGS_MASK_B = 4,
  SVRGS_MASK_EVEN = 5,
  SVRGS_MASK_KINDS
};
#define SVRGS_EVEN_AREA 256

/* Skips: work that is left out because it cannot change the result. As bits of svrgs_options.disabled_skips they are turned off,
   for measurements and tests. */
enum svrgs_skip {
  SVRGS_EXACT_TILES = 1,    /* tiles the 1/255 ellipse reaches instead of those of its bounding box */
  SVRGS_BLOCK_TESTS = 2,    /* 4x4 blocks it reaches instead of all of a tile */
  SVRGS_OPACITY_BOUNDS = 4, /* the ellipse of alpha = 1/255 instead of that of a fully opaque Gaussian */
  SVRGS_TERMINATION = 8,    /* a tile ends where all its pixels have stopped */
  SVRGS_ALL_SKIPS = 15
};

/* Parts of svrgs_forward (the first four), svrgs_backward (two), svrgs_loss and svrgs_adam. */
enum svrgs_stage { SVRGS_PROJECT, SVRGS_TILES, SVRGS_SORT, SVRGS_BLEND, SVRGS_RASTER_GRADS, SVRGS_PARAMETER_GRADS, SVRGS_LOSS, SVRGS_ADAM, SVRGS_STAGES };

typedef struct svrgs_context svrgs_context; /* buffers of one renderer; use from one thread at a time */

typedef struct {
  int64_t count;              /* N */
  int32_t sh_coefficients;    /* 1, 4, 9 or 16 stored per channel */
  const real* means;          /* (N, 3) */
  const real* log_scales;     /* (N, 3) */
  const real* quats;          /* (N, 4) */
  const real* opacity_logits; /* (N,) */
  const real* sh;             /* (N, sh_coefficients, 3) */
  const uint8_t* masks;       /* (N,) 0 or 1, optional: all 1 */
} svrgs_scene;

typedef struct {
  double viewmat[16];    /* world to camera, row-major: a rotation and a translation */
  double fx, fy, cx, cy; /* pixels; orthographic: fx, fy are pixels per unit of length */
  int32_t width, height;
  int32_t orthographic; /* 1: centres are seen at (fx x + cx, fy y + cy), colours along the camera's axis; 0: perspective */
  double background[3];
  double near_depth; /* centres up to this depth are not drawn; 0: near_depth of svrgs_thresholds */
} svrgs_camera;

typedef struct {
  int32_t sh_degree;       /* bands evaluated, at most those stored */
  int32_t antialiased;     /* multiply opacity by sqrt(det before blur / det after blur) */
  int32_t full;            /* F walks the list to its end (1) or stops with the colours (0) */
  int32_t mask_kind;       /* enum svrgs_mask_kind */
  double eps_a;            /* epsilon of scenario A */
  int32_t disabled_skips;  /* enum svrgs_skip bits: skips turned off */
  int64_t max_pairs;       /* refuse more (Gaussian, tile) pairs than this: SVRGS_TOO_LARGE; 0: 2^31 - 1 */
  const int32_t* cancel;   /* optional; polled once per tile, non-zero stops with SVRGS_CANCELLED */
  const real* depth_limit; /* (H, W), optional: a pixel takes a Gaussian only where its z < limit; no gradients and no statistics then */
  int32_t picture_only;    /* 0 or 1: nothing is kept for gradients and statistics, for less time and memory */
  const uint8_t* valid;    /* (H, W), optional: pixels with 0 show nothing: rgb, F, N and K are 0, alpha is 1, and neither gradients nor statistics count them.
                              It must stay unchanged as the scene must */
  double stop;             /* a block of 4x4 pixels ends once the transmittance of all its pixels is below this. The picture lacks at most this share of
                              what is behind it; maxima of alpha T of this size or more are exact. 0 means SVRGS_STOP, the smallest. Needs SVRGS_MASK_NONE */
} svrgs_options;

typedef struct {       /* all optional */
  real* rgb;           /* (H, W, 3) blended colour including background, not clamped */
  real* depth;         /* (H, W) sum of alpha_i T_i z_i */
  real* alpha;         /* (H, W) 1 - T after the last blended Gaussian */
  real* mask;          /* (H, W) F */
  int32_t* hits;       /* (H, W) N: Gaussians on the ray */
  int32_t* kept;       /* (H, W) K: those among them with M = 1 */
  real* transmittance; /* (H, W) T_N: after the last Gaussian counted in N */
} svrgs_images;

typedef struct { /* all optional: dL/d(output), same shapes as the outputs */
  const real* rgb;
  const real* depth;
  const real* alpha;
  const real* mask;
} svrgs_image_grads;

typedef struct { /* all optional: one row per visible Gaussian, in the order of svrgs_visible() */
  real* means;
  real* log_scales;
  real* quats; /* with respect to the stored, not normalised quaternion */
  real* opacity_logits;
  real* sh;      /* (V, sh_coefficients, 3); bands above sh_degree are zero */
  real* masks;   /* dL/dM, for M = 0 and M = 1 alike */
  real* means2d; /* (V, 2) with respect to the projected centre, pixels */
  /* (V, 6) a Gaussian's part of the gradient of the camera's pose, whose rows are summed: with respect to a rotation about the camera centre,
     radians about the camera's axes, and to a translation of the centre along them, world units. Of an orthographic camera without the view
     direction of the colours, which turns with it. */
  real* camera;
} svrgs_grads;

SVRGS_API int32_t svrgs_interface_version(void);
SVRGS_API const char* svrgs_last_error(void);

/* The index-th name of an enum's values (of svrgs_skip: of its index-th bit), for users to choose by; NULL behind the last. */
enum svrgs_names { SVRGS_LEVEL_NAMES, SVRGS_MASK_KIND_NAMES, SVRGS_SKIP_NAMES, SVRGS_STAGE_NAMES };
SVRGS_API const char* svrgs_name(int32_t names, int32_t index);

/* The constants of the model that this build has (native/src/constants.h). */
typedef struct {
  double near_depth, far_depth;            /* a Gaussian is drawn where near < z < far, z the depth of its centre; a camera may have another near */
  double blur;                             /* pixels^2, added to both variances of a projected Gaussian */
  double frustum_margin;                   /* share of half the image: x/z, y/z of the Jacobian are clamped this far outside it */
  double alpha_cut;                        /* a Gaussian hits a pixel where alpha >= alpha_cut */
  double alpha_max;                        /* alpha is clamped to this */
  double stop;                             /* colours stop where the transmittance would fall below this */
  double compensation_floor;               /* of det(before blur) / det(after blur), in antialiased scenes */
  int32_t tile, block_width, block_height; /* pixels */
} svrgs_thresholds;
SVRGS_API void svrgs_get_thresholds(svrgs_thresholds*);

SVRGS_API int32_t svrgs_best_level(void); /* the fastest float level this processor runs */
SVRGS_API int32_t svrgs_level_supported(int32_t level);
SVRGS_API void svrgs_set_threads(int32_t threads); /* 0: one per core; more than 8 per core and 32 are not taken; results do not depend on it */
SVRGS_API int32_t svrgs_threads(void);

/* With 1, and one thread: records the seconds of each task of the thread pool, in order, and -1 before the first task of each job, until a call with 0.
   svrgs_traced gives them; they are valid until the next call with 1. For measurements, from one thread. */
SVRGS_API void svrgs_trace(int32_t on);
SVRGS_API void svrgs_traced(const double** seconds, int64_t* count);

SVRGS_API int32_t svrgs_context_create(int32_t level, svrgs_context** out);
SVRGS_API void svrgs_context_destroy(svrgs_context* context);

/* Renders one view. The scene's arrays must stay unchanged until svrgs_backward or svrgs_scores of this view is done. */
SVRGS_API int32_t svrgs_forward(svrgs_context*, const svrgs_scene*, const svrgs_camera*, const svrgs_options*, const svrgs_images*);

/* Gaussians of the last view that can touch the smallest rectangle that holds all pixels that count: *ids points into the context, valid until the next forward. */
SVRGS_API int32_t svrgs_visible(svrgs_context*, const uint32_t** ids, int64_t* count);

/* Work of the last view. With count_pixels its tile lists are walked again and all fields are filled; otherwise the first two. */
typedef struct {
  int64_t visible, pairs;     /* Gaussians; (Gaussian, tile) entries */
  int64_t used_pairs;         /* entries the backward pass visits */
  int64_t blocks, hit_blocks; /* (Gaussian, 4x4 block) whose alpha was computed; with a lane at alpha >= 1/255 */
  int64_t hits, contributing; /* (Gaussian, pixel) with alpha >= 1/255; blended before the stop */
} svrgs_work;
SVRGS_API int32_t svrgs_count_work(svrgs_context*, int32_t count_pixels, svrgs_work*);

/* Durations of the stages of the last calls, by enum svrgs_stage. SORT ends when all lists are sorted; threads that find none left blend meanwhile. */
SVRGS_API int32_t svrgs_stage_seconds(svrgs_context*, double seconds[SVRGS_STAGES]);

/* Peaks that all threads of the pool reach together: fused multiply-adds at this level (2 operations a lane), reading memory, and
   reading three streams while writing two of them, as Adam does; operations and bytes per second. */
typedef struct {
  double fma, read, update;
} svrgs_machine;
SVRGS_API int32_t svrgs_measure_machine(int32_t level, svrgs_machine*);

/* Gradients of the last view. dL/ddepth needs a forward pass that was asked for depth. */
SVRGS_API int32_t svrgs_backward(svrgs_context*, const svrgs_image_grads*, const svrgs_grads*);

/* Adds the last view to per-Gaussian statistics, each (N,) and optional: sum of alpha_i T_i over pixels, its maximum,
   the number of pixels blended, and the sum of T_i over them. Marks with 1 in `reached` those that hit a ray before it stops, or,
   with options.full, any ray; colours are the same without the others.
   valid: (H, W), optional: pixels with 0 do not count, as in svrgs_options, which then has none. `reached` is of all pixels of the view. */
SVRGS_API int32_t svrgs_scores(svrgs_context*, const uint8_t* valid, double* sum, float* max, int64_t* hits, double* transmittance, uint8_t* reached);

/* How much the last view's colours would change if a Gaussian's shape on the screen did: sums over pixels of w u^a v^b, with
   w = sum over the channels of (alpha_i dC/dalpha_i)^2, and (u, v) = L (pixel - centre), L upper triangular with a positive
   diagonal and alpha_i = opacity 2^-(u^2 + v^2). A row for each visible Gaussian, in the order of svrgs_visible(), (V, SVRGS_MOMENTS):
   uu, uv, vv, uuu, uuv, uvv, vvv, uuuu, uuuv, uuvv, uvvv, vvvv. Together with the projection's Jacobian they are the
   sensitivity of PUP 3D-GS. */
#define SVRGS_MOMENTS 12
SVRGS_API int32_t svrgs_moments(svrgs_context*, double* moments);

/* Adds to cost (N,) by how much the last view's sum of squared residuals, (H, W, 3) colours less photograph, would grow without
   each Gaussian alone: sum over pixels and channels of d^2 - 2 r d with d = alpha_i T_i (c_i - b_i), b_i the colour behind it.
   Exact: a colour is linear in the mask of one Gaussian. With residuals of 0: the sum of d^2. */
SVRGS_API int32_t svrgs_removal(svrgs_context*, const real* residuals, double* cost);

/* Adds the last view to sums (N, SVRGS_VISIBILITY), which svrgs_decimate needs of all views: sums over the pixels in which a Gaussian is
   blended of alpha T, T, 1, |d|^2 and the three channels of d = alpha T (c - b), see svrgs_removal; 1 for the view if there is such a pixel,
   and then fx fy / z^2, the pixels per unit of area at its depth (orthographic: fx fy). */
#define SVRGS_VISIBILITY 9
SVRGS_API int32_t svrgs_visibility(svrgs_context*, double* sums);

/* Adds to sums (N,) the sum over the last view's pixels of (sum over the channels of dC/dG_i)^2, with G_i the value of the Gaussian at the
   pixel, alpha_i = opacity_i G_i. It is the score of Speedy-Splat, which does not differentiate the clamp of alpha either. */
SVRGS_API int32_t svrgs_slopes(svrgs_context*, double* sums);

/* Adds to pixels (N,) the number of the last view's pixels in which alpha_i T_i is the largest of all; of equal ones the nearest counts. */
SVRGS_API int32_t svrgs_dominance(svrgs_context*, double* pixels);

/* L = l1_weight * mean|a - b| + ssim_weight * (1 - SSIM(a, b)); SSIM: 11x11 Gaussian window, sigma 1.5, zero padding,
   C1 = 1e-4, C2 = 9e-4, mean over pixels and channels. image, target, grad: (H, W, 3). grad (dL/dimage) is optional.
   values receives mean|a - b| and SSIM. */
SVRGS_API int32_t svrgs_loss(svrgs_context*, const real* image, const real* target, int32_t height, int32_t width, double l1_weight, double ssim_weight,
                             real* grad, double values[2]);

/* L_F = mean F^2 over `count` pixels (SVR-GS Eq. 10), in *value. grad (count,) receives `weight` times its gradient, 2 weight F / count. */
SVRGS_API int32_t svrgs_mask_loss(svrgs_context*, const real* mask, int64_t count, double weight, real* grad, double* value);

/* FLIP (Andersson et al. 2020) of each pixel: errors (H, W) in [0, 1]; 0: equal. image, target: (H, W, 3) display sRGB in [0, 1].
   pixels_per_degree: of the viewer's visual angle, 1 to 400. */
SVRGS_API int32_t svrgs_flip(int32_t level, const real* image, const real* target, int32_t height, int32_t width, double pixels_per_degree, real* errors);

/* A layer of VGG16 (Simonyan and Zisserman 2015), of which LPIPS is made: 3x3 filters, zeros around the image, then ReLU. image: (H, W, inputs);
   out: (H, W, outputs). outputs: a multiple of SVRGS_CONVOLVE_PANEL. bias: (outputs,). filters: (outputs / SVRGS_CONVOLVE_PANEL, 3, 3, inputs,
   SVRGS_CONVOLVE_PANEL), rows before columns. */
#define SVRGS_CONVOLVE_PANEL 32
SVRGS_API int32_t svrgs_convolve(int32_t level, const real* image, int32_t height, int32_t width, int32_t inputs, const real* filters, const real* bias,
                                 int32_t outputs, real* out);

/* Display colours to linear ones in a working space: rgba (pixels, 4), colours times alpha, and alpha. rgb: (pixels, 3) display sRGB times alpha.
   alpha: (pixels,); where it is not above 0, colours are 0. working_space: 3x3, the rows are linear red, green and blue of sRGB in it. */
SVRGS_API int32_t svrgs_linear_rgba(int32_t level, const real* rgb, const real* alpha, int64_t pixels, const double working_space[9], real* rgba);

/* Colours as a photograph's exposure shows them: seen = A c + b of each pixel. rgb, seen: (pixels, 3). matrix: 3x4, the rows of (A | b). valid: (pixels,),
   seen is 0 where it is 0; NULL: all count. */
SVRGS_API int32_t svrgs_expose(int32_t level, const real* rgb, const uint8_t* valid, int64_t pixels, const double matrix[12], real* seen);

/* Of dL/dseen: d_rgb (pixels, 3) and d_matrix, 3x4. */
SVRGS_API int32_t svrgs_expose_vjp(int32_t level, const real* d_seen, const real* rgb, const uint8_t* valid, int64_t pixels, const double matrix[12],
                                   real* d_rgb, double d_matrix[12]);

/* One Adam step (Kingma and Ba), the `step`th (from 1), of `rows` rows of `width` values; grad is (rows, width). Row r updates row
   ids[r] of param and moments (ids ascending; NULL: row r). lr: one rate per column, (width,). Rows whose gradient is not
   finite are left alone and counted in *nonfinite.

   moments: m and v of each value side by side, 0 to begin with. double: m, v. float: both in a word of 32 bits:

     bits 31 .. 12   m: the upper 20 bits of the float, rounded to nearest
     bits 11 .. 0    v: bits 30 .. 19 of the float (v has no sign), with stochastic rounding

   v needs stochastic rounding because a step changes it by 0.1 %, far less than half of its last bit. n is added to the bits of v before
   they are cut: n = h >> 13, h = (x ^ x >> 15) * 0x85ebca6b, x = (the 20 bits of m, in place) ^ step * 0x9e3779b1.

   shared: rows are SH coefficients, (K, 3) values each, width 3, 12, 27 or 48. A row has one v, of the mean square of its first three
   gradients, those of degree 0. A row of moments: m of every value, then v. double: width + 1 values. float: m in 16 bits each, the upper
   half of the float, with stochastic rounding (n = h >> 16, x as above); 2 bytes of padding if the width is odd; v in 32 bits. */
typedef struct {
  const double* lr;
  double beta1, beta2, eps;
  int64_t step;
  int32_t shared; /* 0 or 1 */
} svrgs_adam_settings;
SVRGS_API int32_t svrgs_adam(svrgs_context*, const svrgs_adam_settings*, real* param, void* moments, const real* grad, const uint32_t* ids, int64_t rows,
                             int32_t width, int64_t* nonfinite);

/* svrgs_backward and svrgs_adam in one, bit for bit: the gradients of the last view go straight into an Adam step on the rows
   of the visible Gaussians (of the scene's own arrays, which this call may write) and are not stored. A tensor whose
   param is NULL is not updated; sh must have one. masks: the existence logits, whose gradient is dL/dM times `slope`. `others` may ask for
   the gradients of tensors that are not updated, and of means2d. The view cannot be used afterwards: the scene it was made from has changed.
   Frozen Gaussians are blended, but not updated, and have no row in `others`. */
typedef struct {
  real* param;      /* (N, columns) */
  void* moments;    /* a row of N each, as in svrgs_adam; of sh: shared */
  const double* lr; /* (columns,) */
} svrgs_trained;
typedef struct {
  svrgs_adam_settings adam; /* its lr and shared are not read */
  svrgs_trained means, log_scales, quats, opacity_logits, sh, masks;
  const real* slope;     /* (N,) dM/dlogit; read if masks are updated */
  const uint8_t* frozen; /* (N,) 0 or 1; NULL: none */
} svrgs_update;
SVRGS_API int32_t svrgs_backward_update(svrgs_context*, const svrgs_image_grads*, const svrgs_update*, const svrgs_grads* others, int64_t* nonfinite);

/* Draws M_i = [d_i + l_i > 0], l logistic noise keyed by (seed, step, i); slope receives the straight-through
   derivative sigma(d + l)(1 - sigma(d + l)). */
SVRGS_API int32_t svrgs_sample_masks(const float* logits, int64_t count, uint64_t seed, uint64_t step, uint8_t* masks, float* slope);

/* Decimation: an order of operations, each of which removes a Gaussian or merges two neighbours into one, the cheapest first, until `least`
   are left. The number that are left after k of them is count - k, so one order gives every number.
   The cost of a removal is its removal error. The cost of a merge is the change of the picture without occlusion, closed form, mean of the
   views along the three axes, scaled by what the views see of it (kernels/merge-inl.h). A merged Gaussian has the mean, the covariance and
   the SH of both, weighted by alpha T, and the opacity that keeps the sum of opacity times area. */
typedef struct {
  int64_t count;               /* N */
  int32_t sh_coefficients;     /* 1, 4, 9 or 16 */
  int32_t antialiased;         /* as in svrgs_options */
  const float* means;          /* (N, 3) */
  const float* log_scales;     /* (N, 3) */
  const float* quats;          /* (N, 4) */
  const float* opacity_logits; /* (N,) */
  const float* sh;             /* (N, sh_coefficients, 3) */
  const double* visibility;    /* (N, SVRGS_VISIBILITY) */
  double middle[3], unit;      /* of the scene; a length of about a pixel */
  int64_t least;               /* Gaussians left at the end, from 1 to N */
} svrgs_decimation;

/* With N - least rows each, the k-th operation in row k; the results of merges in the order of the operations. */
typedef struct {
  uint32_t *a, *b; /* a is removed, and b is UINT32_MAX; or a and b are merged. Below N: rows of the scene. N + m: the result of merge m */
  float* costs;    /* growth of the sum of squared errors over all views */
  float *means, *log_scales, *quats, *opacity_logits, *sh;
} svrgs_merges;

/* Costs are computed with the kernels of `level`. steps, merges: how many operations, and how many of them are merges. */
SVRGS_API int32_t svrgs_decimate(int32_t level, const svrgs_decimation*, const int32_t* cancel, const svrgs_merges*, int64_t* steps, int64_t* merges);

/* A picture on triangles: 3 bytes a texel, display sRGB, rows from v = 0 on. Levels lie one after the other down to 1 x 1, each with half the
   sides of the one before, rounded up. */
typedef struct {
  const uint8_t* texels;
  int32_t width, height; /* of the first level */
  int32_t repeat;        /* outside 0..1: 1 repeats the picture, 0 its border */
} svrgs_texture;

/* Opaque triangles. The colour at a point is color * texture * max(0, ambient + light), with -light on the side that is seen counter to
   (corner 1 - corner 0) x (corner 2 - corner 0); values of corners are interpolated. */
typedef struct {
  int64_t count;                /* M */
  const float* corners;         /* (M, 3, 3) world: triangle, corner, coordinate */
  const float* colors;          /* (M, 3, 3) linear */
  const float* light;           /* (M, 3) */
  const float* uvs;             /* (M, 3, 2); optional without textures */
  const int32_t* textures;      /* (M,) index of the texture, -1: none; optional: none has one */
  const uint8_t* holdout;       /* (M,) 1: shows nothing, and hides what is behind */
  const svrgs_texture* texture; /* (texture_count,) */
  int32_t texture_count;
  double ambient;
} svrgs_triangles;

/* Each pixel has 8 samples. Where their depths differ by more than 1 % they are split at the largest gap: layer 0 is the nearer part, layer 1
   the farther one or what no triangle covers. */
typedef struct {
  float* share; /* (H, W) of the pixel that layer 0 has; 1: there is no layer 1 */
  float* depth; /* (2, H, W) mean camera z of the samples; infinite where there is no triangle */
  float* rgba;  /* (2, H, W, 4) display sRGB times alpha; alpha: share of the layer's samples that show a triangle, not a holdout */
} svrgs_layers;

/* Draws triangles; reads pose, intrinsics and size of the camera. Results do not depend on the number of threads. */
SVRGS_API int32_t svrgs_draw_triangles(const svrgs_triangles*, const svrgs_camera*, const svrgs_layers*);

/* A perspective view that is a part of a panorama. */
typedef struct {
  const float* image; /* (height, width, channels) */
  int32_t width, height, channels;
  int32_t along;        /* the channel with values along z, which become values along the ray; -1: none */
  double turn[9];       /* rotation from the panorama's frame to that of the view, row-major */
  double focal, cx, cy; /* pixels */
} svrgs_view;

/* An equirectangular picture. The direction of a pixel is (sin lon cos lat, -sin lat, cos lon cos lat). */
typedef struct {
  float* sums; /* (height, width, channels) */
  int32_t width, height;
  const double *latitudes, *row_weights;     /* (height,) */
  const double *longitudes, *column_weights; /* (width,) */
} svrgs_panorama;

/* Adds row weight times column weight times the view, by cubic interpolation, to all pixels where that is not 0. */
SVRGS_API int32_t svrgs_add_view(const svrgs_view*, const svrgs_panorama*);

#ifdef __cplusplus
}
#endif
#endif
