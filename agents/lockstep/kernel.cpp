// Multi-layer perceptrons of one shape, each computed by itself: outputs, products with the Jacobian
// in the parameters and the inputs, passes of Adam over minibatches, and conjugate gradients. Sums
// run in an order that depends only on the rows of the network itself, so that its numbers are the
// same, bit for bit, whatever other networks are computed.
//
// The parameters of a layer are a matrix [in + 1][out], the weights and, as the last row, the
// biases; layers lie one behind the other. Rows of inputs go through all layers ROWS at a time,
// transposed, as matrices [in + 1][ROWS] whose last row is 1, so that a layer, biases included, is
// one matrix product, and so is its gradient. All numbers are float32.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#ifdef __AVX512F__
constexpr int LANES = 16, SUMS = 24; // vectors of sums that fit into the registers
#else
constexpr int LANES = 8, SUMS = 12;
#endif
constexpr int64_t ROWS = 64; // layers of so many rows fit into the first two levels of cache
typedef float Vector __attribute__((vector_size(4 * LANES), aligned(4)));

static Vector all(float x) { return Vector{} + x; }
static int64_t filled(int64_t n) { return (n + LANES - 1) / LANES * LANES; }

// Load or store the first `count` numbers of a vector, all of them if count is larger.
static Vector load(const float *p, int64_t count) {
  if (count >= LANES) return *(const Vector *)p;
  Vector v{};
  for (int i = 0; i < LANES; i++)
    if (i < count) v[i] = p[i];
  return v;
}
static void store(float *p, Vector v, int64_t count) {
  if (count >= LANES)
    *(Vector *)p = v;
  else
    for (int i = 0; i < LANES; i++)
      if (i < count) p[i] = v[i];
}

// Memory that begins at a cache line and is valid until the next call with the same `which`.
static float *aligned(float *p) { return (float *)(((uintptr_t)p + 63) & ~(uintptr_t)63); }
static float *scratch(int which, int64_t size) {
  static thread_local std::vector<float> kept[8];
  if ((int64_t)kept[which].size() < size + 16) kept[which].resize(size + 16);
  return aligned(kept[which].data());
}

// Compiled with -O2, which takes two thirds of the time of -O3 and gives code as fast. What -O2
// leaves out is asked for below: loops over registers are unrolled, the function in the loop of
// activations is inlined, and matrices are transposed with -O3.

// c[m][n] = (c[m][n] +) sum_k a(m, k) b[k][n]; a(m, k) = a[m * am + k * ak]; N vectors of columns,
// the last of which holds `last` columns of c.
struct Operands {
  const float *a;
  int64_t am, ak;
  const float *b;
  int64_t bk;
  float *c;
  int64_t cm, depth;
  bool add;
};
template <int M, int N> static void tile(const Operands &o, int64_t m0, int64_t n0, int64_t last) {
  const float *a = o.a + m0 * o.am, *b = o.b + n0;
  float *c = o.c + m0 * o.cm + n0;
  Vector sum[M][N];
#pragma GCC unroll 16
  for (int m = 0; m < M; m++)
#pragma GCC unroll 16
    for (int n = 0; n < N; n++)
      sum[m][n] = o.add ? load(c + m * o.cm + LANES * n, n < N - 1 ? LANES : last) : Vector{};
  for (int64_t k = 0; k < o.depth; k++) {
    Vector right[N];
#pragma GCC unroll 16
    for (int n = 0; n < N; n++) right[n] = *(const Vector *)(b + k * o.bk + LANES * n);
#pragma GCC unroll 16
    for (int m = 0; m < M; m++) {
      const Vector left = all(a[m * o.am + k * o.ak]);
#pragma GCC unroll 16
      for (int n = 0; n < N; n++) sum[m][n] += left * right[n];
    }
  }
#pragma GCC unroll 16
  for (int m = 0; m < M; m++)
#pragma GCC unroll 16
    for (int n = 0; n < N; n++)
      store(c + m * o.cm + LANES * n, sum[m][n], n < N - 1 ? LANES : last);
}

template <int N> static void strip(const Operands &o, int64_t rows, int64_t n, int64_t last) {
  constexpr int M = SUMS / N < 12 ? SUMS / N : 12;
  int64_t m = 0;
  for (; m + M <= rows; m += M) tile<M, N>(o, m, n, last);
  for (; m + 4 <= rows; m += 4) tile<4, N>(o, m, n, last);
  for (; m < rows; m++) tile<1, N>(o, m, n, last);
}

// The product for all of c [rows][columns]; the rows of b are padded to whole vectors.
static void product(const Operands &o, int64_t rows, int64_t columns) {
  constexpr int64_t MOST = SUMS / 6;
  for (int64_t n = 0; n < columns; n += MOST * LANES) {
    const int64_t left = columns - n, vectors = std::min(MOST, (left + LANES - 1) / LANES);
    const int64_t last = std::min<int64_t>(LANES, left - (vectors - 1) * LANES);
    if (vectors == 1) strip<1>(o, rows, n, last);
    if (vectors == 2) strip<2>(o, rows, n, last);
    if (vectors == 3) strip<3>(o, rows, n, last);
    if (vectors == 4) strip<4>(o, rows, n, last);
  }
}

template <size_t... I> static Vector low(Vector a, Vector b, std::index_sequence<I...>) {
  return Vector{(I % 2 ? b : a)[I / 2]...};
}
template <size_t... I> static Vector high(Vector a, Vector b, std::index_sequence<I...>) {
  return Vector{(I % 2 ? b : a)[(LANES + I) / 2]...};
}

// Transpose: to[j][i] = from[index[i] or i][j] for j < columns and i < width, 0 for i >= rows.
__attribute__((optimize("O3"))) static void turn(const float *from, int64_t stride,
                                                 const int64_t *index, int64_t rows,
                                                 int64_t columns, float *to, int64_t to_stride,
                                                 int64_t width) {
  const std::make_index_sequence<LANES> each;
  for (int64_t r = 0; r < width; r += LANES)
    for (int64_t c = 0; c < columns; c += LANES) {
      Vector x[LANES], y[LANES];
      for (int64_t i = 0; i < LANES; i++)
        x[i] = r + i < rows ? load(from + (index ? index[r + i] : r + i) * stride + c, columns - c)
                            : Vector{};
      for (int length = LANES; length > 1; length /= 2) { // halves are shuffled into each other
        for (int i = 0; i < LANES / 2; i++) {
          y[2 * i] = low(x[i], x[i + LANES / 2], each);
          y[2 * i + 1] = high(x[i], x[i + LANES / 2], each);
        }
        memcpy(x, y, sizeof x);
      }
      for (int64_t j = 0; j < LANES && c + j < columns; j++)
        store(to + (c + j) * to_stride + r, x[j], width - r);
    }
}

// tanh as a quotient of polynomials, as in Eigen, with an error below 5e-7.
__attribute__((always_inline)) static inline Vector hyperbolic(Vector x) {
  const Vector top = all(7.90531110763549805f);
  x = x > top ? top : x;
  x = x < -top ? -top : x;
  const Vector s = x * x;
  Vector p = s * -2.76076847742355e-16f + 2.00018790482477e-13f;
  p = s * p + -8.60467152213735e-11f;
  p = s * p + 5.12229709037114e-08f;
  p = s * p + 1.48572235717979e-05f;
  p = s * p + 6.37261928875436e-04f;
  p = s * p + 4.89352455891786e-03f;
  Vector q = s * 1.19825839466702e-06f + 1.18534705686654e-04f;
  q = s * q + 2.26843463243900e-03f;
  q = s * q + 4.89352518554385e-03f;
  return x * p / q;
}

enum Activation { TANH, RELU, SILU };

struct Net {
  int layers;       // number of weight matrices
  const int64_t *n; // layers + 1 widths
  int kind;         // Activation
  // For each layer: where its parameters begin; where in the tape of ROWS rows its inputs [n + 1]
  // [ROWS] begin, and the slopes [n][ROWS] of silu, which do not follow from the activations.
  std::vector<int64_t> weights, inputs, slopes;
  int64_t size = 0, tape = 0, widest = 0; // of the parameters, of a tape, of the widest layer

  Net(int layers, const int64_t *n, int kind) : layers(layers), n(n), kind(kind) {
    for (int l = 0; l <= layers; l++) widest = std::max(widest, filled(n[l]));
    for (int l = 0; l < layers; l++) {
      weights.push_back(size);
      size += (n[l] + 1) * n[l + 1];
      inputs.push_back(tape);
      tape += (n[l] + 1) * ROWS;
      slopes.push_back(tape);
      if (l && kind == SILU) tape += n[l] * ROWS;
    }
  }
  int64_t tapes(int64_t rows) const { return (rows + ROWS - 1) / ROWS * tape; }

  // Write inputs x [.][width] into a tape: the rows of `index`, or the first if it is null.
  void begin(const float *x, int64_t width, const int64_t *index, int64_t rows,
             float *tape) const {
    turn(x, width, index, rows, n[0], tape, ROWS, filled(rows));
    for (int l = 0; l < layers; l++)
      for (int64_t i = 0; i < ROWS; i++) tape[inputs[l] + n[l] * ROWS + i] = 1.0f;
  }

  // Compute the outputs y [out][ROWS] of a tape; columns: rows, padded to whole vectors.
  void values(const float *p, float *tape, float *y, int64_t columns) const {
    for (int l = 0; l < layers; l++) {
      float *to = l + 1 < layers ? tape + inputs[l + 1] : y;
      product({p + weights[l], 1, n[l + 1], tape + inputs[l], ROWS, to, ROWS, n[l] + 1, false},
              n[l + 1], columns);
      if (l + 1 < layers) activate(to, tape + slopes[l + 1], n[l + 1], columns);
    }
  }

  void activate(float *x, float *slope, int64_t features, int64_t columns) const {
    const Vector one = all(1.0f), zero{};
    for (int64_t i = 0; i < features * ROWS; i += ROWS)
      for (int64_t j = i; j < i + columns; j += LANES) {
        const Vector z = *(Vector *)(x + j);
        if (kind == TANH)
          *(Vector *)(x + j) = hyperbolic(z);
        else if (kind == RELU)
          *(Vector *)(x + j) = z < zero ? zero : z; // NaN stays
        else {
          const Vector s = 0.5f * hyperbolic(0.5f * z) + 0.5f;
          *(Vector *)(x + j) = z * s;
          *(Vector *)(slope + j) = s * (one + z * (one - s));
        }
      }
  }

  // Multiply y [n][ROWS] of hidden layer l by the slopes of the activation.
  void steepen(int l, float *y, const float *tape, int64_t columns) const {
    const float *value = tape + inputs[l], *slope = tape + slopes[l];
    const Vector one = all(1.0f), zero{};
    for (int64_t i = 0; i < n[l] * ROWS; i += ROWS)
      for (int64_t j = i; j < i + columns; j += LANES) {
        const Vector v = *(const Vector *)(value + j);
        Vector &to = *(Vector *)(y + j);
        if (kind == TANH)
          to *= one - v * v;
        else if (kind == RELU)
          to = v > zero ? to : v - v; // NaN stays
        else
          to *= *(const Vector *)(slope + j);
      }
  }

  // Multiply the first rows of delta [out][ROWS] with the Jacobian: add the products in the
  // parameters to g, unless it is null; return those in the inputs, [in][ROWS], if of_inputs.
  float *pull(const float *p, const float *tape, float *delta, float *g, bool of_inputs,
              int64_t rows) const {
    float *turned = scratch(0, ROWS * widest), *before = scratch(1, widest * ROWS);
    float *other = scratch(2, widest * ROWS);
    for (int l = layers - 1; l >= 0; l--) {
      const int64_t in = n[l], out = n[l + 1], width = filled(out);
      if (g) {
        turn(delta, ROWS, nullptr, out, rows, turned, width, width);
        product({tape + inputs[l], ROWS, 1, turned, width, g + weights[l], out, rows, true}, in + 1,
                out);
      }
      if (l == 0 && !of_inputs) return nullptr;
      product({p + weights[l], out, 1, delta, ROWS, before, ROWS, out, false}, in, filled(rows));
      if (l) steepen(l, before, tape, filled(rows));
      delta = before;
      std::swap(before, other);
    }
    return delta;
  }

  // Return the product of the Jacobian in the parameters with v, [out][ROWS].
  float *push(const float *p, const float *v, const float *tape, int64_t columns) const {
    float *dot = scratch(4, widest * ROWS), *next = scratch(5, widest * ROWS); // pull has 0 to 2
    for (int l = 0; l < layers; l++) {
      const int64_t in = n[l], out = n[l + 1];
      product({v + weights[l], 1, out, tape + inputs[l], ROWS, next, ROWS, in + 1, false}, out,
              columns);
      if (l) product({p + weights[l], 1, out, dot, ROWS, next, ROWS, in, true}, out, columns);
      if (l + 1 < layers) steepen(l + 1, next, tape, columns);
      std::swap(dot, next);
    }
    return dot;
  }
};

// A step of Adam down a gradient times `scale`; decays: beta^t after it. Source: Kingma & Ba 2015,
// algorithm 1.
constexpr float BETA1 = 0.9f, BETA2 = 0.999f, EPSILON = 1e-8f;
static void step(int64_t size, float *__restrict params, const float *__restrict gradient,
                 float scale, float *__restrict mean, float *__restrict square, float decay1,
                 float decay2, float rate) {
  const float by_mean = rate / (1.0f - decay1), by_square = 1.0f / (1.0f - decay2);
  for (int64_t i = 0; i < size; i++) {
    const float g = gradient[i] * scale;
    mean[i] += (1.0f - BETA1) * (g - mean[i]);
    square[i] = BETA2 * square[i] + (1.0f - BETA2) * g * g;
    params[i] -= by_mean * mean[i] / (sqrtf(square[i] * by_square) + EPSILON);
  }
}

static float dot(const float *a, const float *b, int64_t size) {
  Vector sum[4] = {};
  for (int64_t i = 0; i < size; i += LANES)
    sum[i / LANES % 4] += load(a + i, size - i) * load(b + i, size - i);
  sum[0] += sum[1] + sum[2] + sum[3];
  float whole = 0.0f;
  for (int i = 0; i < LANES; i++) whole += sum[0][i];
  return whole;
}

template <typename T> static double dot(const double *a, const T *b, int64_t size) {
  double sum[8] = {}, whole = 0.0;
  int64_t i = 0;
  for (; i + 8 <= size; i += 8)
    for (int k = 0; k < 8; k++) sum[k] += a[i + k] * b[i + k];
  for (; i < size; i++) whole += a[i] * b[i];
  for (double part : sum) whole += part;
  return whole;
}

// Replace the first rows of values y [ROWS] by the slopes of half the mean squared error; return
// their part of that error.
static float squared(float *y, const int64_t *index, const float *target, float weight,
                     int64_t rows) {
  float loss = 0.0f;
  for (int64_t i = 0; i < rows; i++) {
    const float error = y[i] - target[index[i]];
    y[i] = weight * error;
    loss += 0.5f * y[i] * error;
  }
  return loss;
}

// Replace means y [actions][ROWS] by the slopes of the negative mean of the clipped surrogate, and
// add the slopes in log_std to `of_log_std`; return the share of rows whose ratio is outside the
// range. Advantages and log-probabilities are `index`ed, actions are not.
static float clipped(const float *log_std, float *y, const float *action, const int64_t *index,
                     const float *advantage, const float *old_log_prob, float range, float weight,
                     int64_t actions, int64_t rows, float *of_log_std) {
  float log_prob[ROWS] = {}, slope[ROWS], outside = 0.0f;
  for (int64_t j = 0; j < actions; j++) {
    const float by_std = 1.0f / expf(log_std[j]);
    for (int64_t i = 0; i < rows; i++) {
      const float z = (action[j * ROWS + i] - y[j * ROWS + i]) * by_std;
      y[j * ROWS + i] = z;
      log_prob[i] += -0.5f * z * z - log_std[j] - 0.91893853f; // log(2 pi) / 2
    }
  }
  for (int64_t i = 0; i < rows; i++) {
    const float ratio = expf(log_prob[i] - old_log_prob[index[i]]), gain = advantage[index[i]];
    const bool beyond = fabsf(ratio - 1.0f) > range;
    slope[i] = beyond && (ratio > 1.0f) == (gain > 0.0f) ? 0.0f : -weight * gain * ratio;
    if (beyond) outside += weight;
  }
  for (int64_t j = 0; j < actions; j++) {
    const float by_std = 1.0f / expf(log_std[j]);
    for (int64_t i = 0; i < rows; i++) {
      const float z = y[j * ROWS + i];
      of_log_std[j] += slope[i] * (z * z - 1.0f);
      y[j * ROWS + i] = slope[i] * z * by_std;
    }
  }
  return outside;
}

// The damped Hessian of the mean KL divergence of a policy from itself, over weighted rows:
// damping + J^T M J, where J is the Jacobian of means and log_stds, and M, 1 / variance and 2, the
// Fisher information of a Gaussian in them.
struct Curvature {
  const Net &net;
  const float *p;
  int64_t log_std, actions, size; // where log_stds begin; their number; that of parameters
  float damping;
  std::vector<float> weight, tapes; // padded

  // Compute the tapes of rows x [rows][width]; w: their weights.
  void begin(const float *x, int64_t width, const float *w, int64_t rows) {
    while (rows > 0 && w[rows - 1] == 0.0f) rows--;
    weight.assign(w, w + rows);
    weight.resize((rows + ROWS - 1) / ROWS * ROWS);
    tapes.resize(net.tapes(rows) + 16);
    float *tape = aligned(tapes.data()), *y = scratch(3, net.widest * ROWS);
    for (int64_t r = 0; r < rows; r += ROWS, tape += net.tape) {
      net.begin(x + r * width, width, nullptr, std::min(ROWS, rows - r), tape);
      net.values(p, tape, y, ROWS);
    }
  }

  void product(const float *v, float *to) {
    float whole = 0.0f, *tape = aligned(tapes.data());
    for (float w : weight) whole += w;
    for (int64_t i = 0; i < size; i++) to[i] = 0.0f;
    for (size_t r = 0; r < weight.size(); r += ROWS, tape += net.tape) {
      float *y = net.push(p, v, tape, ROWS);
      for (int64_t j = 0; j < actions; j++) {
        const float by_variance = expf(-2.0f * p[log_std + j]);
        for (int64_t i = 0; i < ROWS; i++) y[j * ROWS + i] *= weight[r + i] * by_variance;
      }
      net.pull(p, tape, y, to, false, ROWS);
    }
    for (int64_t j = 0; j < actions; j++) to[log_std + j] = 2.0f * whole * v[log_std + j];
    for (int64_t i = 0; i < size; i++) to[i] += damping * v[i];
  }

  // Solve H x = b by conjugate gradients from x = 0, until the residual vanishes. The vectors have
  // double precision: their rounding errors are magnified up to a hundred times as much as H's.
  void solve(const float *b, int64_t iterations, float *x) {
    std::vector<double> sum(size), residual(b, b + size), direction = residual;
    std::vector<float> along(size), image(size);
    double square = dot(residual.data(), residual.data(), size);
    const double least = 1e-10 * square;
    for (int64_t k = 0; k < iterations && square > least; k++) {
      std::copy(direction.begin(), direction.end(), along.begin());
      product(along.data(), image.data());
      const double step = square / dot(direction.data(), image.data(), size), before = square;
      for (int64_t i = 0; i < size; i++) sum[i] += step * direction[i];
      for (int64_t i = 0; i < size; i++) residual[i] -= step * image[i];
      square = dot(residual.data(), residual.data(), size);
      for (int64_t i = 0; i < size; i++)
        direction[i] = residual[i] + square / before * direction[i];
    }
    std::copy(sum.begin(), sum.end(), x);
  }
};

extern "C" {

// Make glibc give freed blocks to the next array instead of returning them to the system: the page
// faults of new megabytes cost as much as the arithmetic that fills them.
void keep_freed_memory() {
#ifdef __GLIBC__
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, INT32_MAX);
  mallopt(M_TOP_PAD, 64 << 20);
#endif
}

// Return the length of a network's tape of some rows; all tapes together need a cache line more.
int64_t tape_size(int layers, const int64_t *n, int kind, int64_t rows) {
  return Net(layers, n, kind).tapes(rows);
}

// Compute the outputs y [nets][rows][out] of networks params [nets], `stride` numbers apart, for
// inputs x [nets / share][rows][in], and their tape, unless it is null.
void forward(int layers, const int64_t *n, int kind, int64_t nets, const float *params,
             int64_t stride, int64_t rows, float *tape, const float *x, int64_t share, float *y) {
  const Net net(layers, n, kind);
  const int64_t out = n[layers];
  float *outputs = scratch(3, net.widest * ROWS);
  const int64_t kept = tape ? net.tape : 0;
  tape = tape ? aligned(tape) : scratch(4, net.tape);
  for (int64_t k = 0; k < nets; k++)
    for (int64_t r = 0; r < rows; r += ROWS, tape += kept) {
      const int64_t some = std::min(ROWS, rows - r);
      net.begin(x + (k / share * rows + r) * n[0], n[0], nullptr, some, tape);
      net.values(params + k * stride, tape, outputs, filled(some));
      turn(outputs, ROWS, nullptr, out, some, y + (k * rows + r) * out, out, out);
    }
}

// Multiply dy [nets][rows][out] with the Jacobian: in the parameters, gp [nets][gstride], 0 behind
// the network's own; in the inputs, gx [nets][rows][in]. Either may be null.
void backward(int layers, const int64_t *n, int kind, int64_t nets, const float *params,
              int64_t stride, int64_t rows, float *tape, const float *dy, float *gp,
              int64_t gstride, float *gx) {
  const Net net(layers, n, kind);
  const int64_t in = n[0], out = n[layers];
  float *delta = scratch(3, net.widest * ROWS);
  tape = aligned(tape);
  for (int64_t k = 0; k < nets; k++) {
    float *g = gp ? gp + k * gstride : nullptr;
    if (g) memset(g, 0, 4 * gstride);
    for (int64_t r = 0; r < rows; r += ROWS, tape += net.tape) {
      const int64_t some = std::min(ROWS, rows - r);
      turn(dy + (k * rows + r) * out, out, nullptr, some, out, delta, ROWS, filled(some));
      const float *found = net.pull(params + k * stride, tape, delta, g, gx, some);
      if (gx) turn(found, ROWS, nullptr, in, some, gx + (k * rows + r) * in, in, in);
    }
  }
}

// Take one step of Adam for each run, all [runs][size], in place; decays [runs]: beta^t before it.
void adam(int64_t runs, int64_t size, float *params, const float *gradient, float *mean,
          float *square, float *decay1, float *decay2, float rate) {
  for (int64_t r = 0, at = 0; r < runs; r++, at += size) {
    decay1[r] *= BETA1, decay2[r] *= BETA2;
    step(size, params + at, gradient + at, 1.0f, mean + at, square + at, decay1[r], decay2[r],
         rate);
  }
}

// Make a pass of Adam over minibatches of each run's rows, for its `share` networks, in place:
// params and moments [runs][share][stride], decays [runs]. Inputs x [runs][rows][width], of which
// networks see the first n[0]; order of the rows [runs][most], the first `steps` [runs] count. The
// loss is half the squared error from targets [runs][share][rows] or, if there are actions
// [runs][rows][out], the clipped surrogate of policies, whose log_stds begin at `log_std`. Gradients
// are clipped to the norm `longest`. Adds to records [runs][share] what the loss records.
void descend(int layers, const int64_t *n, int kind, int64_t runs, int64_t share, float *params,
             int64_t stride, int64_t log_std, float *mean, float *square, float *decay1,
             float *decay2, const float *x, int64_t rows, int64_t width, const int64_t *order,
             int64_t most, const int64_t *steps, int64_t batch, const float *action,
             const float *advantage, const float *old_log_prob, float range, const float *target,
             float longest, float rate, float *records) {
  const Net net(layers, n, kind);
  const int64_t out = n[layers], used = action ? log_std + out : net.size;
  float *tape = scratch(3, net.tape), *y = scratch(4, net.widest * ROWS), *g = scratch(5, used);
  float *acted = scratch(6, net.widest * ROWS);
  for (int64_t r = 0; r < runs; r++)
    for (int64_t start = 0; start < steps[r]; start += batch) {
      const int64_t held = std::min(batch, steps[r] - start);
      decay1[r] *= BETA1, decay2[r] *= BETA2;
      for (int64_t k = r * share; k < (r + 1) * share; k++) {
        float *p = params + k * stride;
        memset(g, 0, 4 * used);
        for (int64_t c = 0; c < held; c += ROWS) {
          const int64_t some = std::min(ROWS, held - c), *index = order + r * most + start + c;
          if (k == r * share || held > ROWS)
            net.begin(x + r * rows * width, width, index, some, tape);
          net.values(p, tape, y, filled(some));
          if (action) {
            turn(action + r * rows * out, out, index, some, out, acted, ROWS, filled(some));
            records[k] += clipped(p + log_std, y, acted, index, advantage + r * rows,
                                  old_log_prob + r * rows, range, 1.0f / held, out, some,
                                  g + log_std);
          } else
            records[k] += squared(y, index, target + k * rows, 1.0f / held, some);
          net.pull(p, tape, y, g, false, some);
        }
        const float scale = std::isinf(longest) ? 1.0f : longest / (sqrtf(dot(g, g, used)) + 1e-6f);
        step(used, p, g, std::min(scale, 1.0f), mean + k * stride, square + k * stride, decay1[r],
             decay2[r], rate);
      }
    }
}

// Compute H v for the policies params [runs][stride] and v [runs][stride], or with iterations the x
// of H x = v; inputs x [runs][rows][width], of which networks see the first; weight [runs][rows].
void curvature(int layers, const int64_t *n, int kind, int64_t runs, const float *params,
               int64_t stride, int64_t log_std, const float *x, int64_t rows, int64_t width,
               const float *weight, float damping, const float *v, int64_t iterations, float *to) {
  const Net net(layers, n, kind);
  for (int64_t r = 0; r < runs; r++) {
    Curvature of{net, params + r * stride, log_std, n[layers], stride, damping, {}, {}};
    of.begin(x + r * rows * width, width, weight + r * rows, rows);
    if (iterations)
      of.solve(v + r * stride, iterations, to + r * stride);
    else
      of.product(v + r * stride, to + r * stride);
  }
}
}
