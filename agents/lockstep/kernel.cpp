// Multi-layer perceptrons of one shape, each computed by itself: values, products with the Jacobian
// in the parameters and the inputs, and Adam. Sums run in an order that depends on a network's own
// rows alone, so that a network's numbers are the same, bit for bit, whatever others are computed.
//
// A network's parameters are, layer by layer, weights [in][out] and biases [out], one behind the
// other. Widths of hidden layers are multiples of 16. All numbers are float32.
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#ifdef __AVX512F__
constexpr int LANES = 16, COLUMNS = 4; // 6 rows of as many vectors fit into the registers
#else
constexpr int LANES = 8, COLUMNS = 2;
#endif
typedef float Vector __attribute__((vector_size(4 * LANES), aligned(4)));
constexpr int64_t ROWS = 64; // rows that go through all layers together, in the first-level cache
constexpr int WIDTH = 16;    // multiple to which the last layer is filled

static Vector all(float x) { return Vector{} + x; }

// c[m][n] += sum_k a(m, k) b[k][n]; a(m, k) = a[m * am + k * ak].
template <int M, int N>
static void tile(const float *a, int64_t am, int64_t ak, const float *b, int64_t bk, float *c,
                 int64_t cm, int64_t depth) {
  Vector sum[M][N];
  for (int m = 0; m < M; m++)
    for (int n = 0; n < N; n++) sum[m][n] = *(const Vector *)(c + m * cm + LANES * n);
  for (int64_t k = 0; k < depth; k++) {
    Vector right[N];
    for (int n = 0; n < N; n++) right[n] = *(const Vector *)(b + k * bk + LANES * n);
    for (int m = 0; m < M; m++) {
      const Vector left = all(a[m * am + k * ak]);
      for (int n = 0; n < N; n++) sum[m][n] += left * right[n];
    }
  }
  for (int m = 0; m < M; m++)
    for (int n = 0; n < N; n++) *(Vector *)(c + m * cm + LANES * n) = sum[m][n];
}

template <int N>
static void strip(const float *a, int64_t am, int64_t ak, const float *b, int64_t bk, float *c,
                  int64_t cm, int64_t rows, int64_t depth) {
  constexpr int M = N == 1 ? 12 : 6; // as many sums at once hide the latency of a product
  int64_t m = 0;
  for (; m + M <= rows; m += M) tile<M, N>(a + m * am, am, ak, b, bk, c + m * cm, cm, depth);
  for (; m + 2 <= rows; m += 2) tile<2, N>(a + m * am, am, ak, b, bk, c + m * cm, cm, depth);
  for (; m < rows; m++) tile<1, N>(a + m * am, am, ak, b, bk, c + m * cm, cm, depth);
}

// As `tile` for any rows, and columns that are a multiple of 16.
static void product(const float *a, int64_t am, int64_t ak, const float *b, int64_t bk, float *c,
                    int64_t cm, int64_t rows, int64_t columns, int64_t depth) {
  int64_t n = 0;
  for (; n + LANES * COLUMNS <= columns; n += LANES * COLUMNS)
    strip<COLUMNS>(a, am, ak, b + n, bk, c + n, cm, rows, depth);
  for (; n < columns; n += LANES) strip<1>(a, am, ak, b + n, bk, c + n, cm, rows, depth);
}

// tanh as the quotient of polynomials that Eigen takes, within 5e-7.
static Vector hyperbolic(Vector x) {
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

// The activation of `count` numbers in place, and of silu its slope there, which the values do not
// tell; count is a multiple of 16.
static void activate(int kind, float *x, float *slope, int64_t count) {
  const Vector one = all(1.0f), zero = all(0.0f);
  for (int64_t i = 0; i < count; i += LANES) {
    const Vector z = *(Vector *)(x + i);
    if (kind == TANH)
      *(Vector *)(x + i) = hyperbolic(z);
    else if (kind == RELU)
      *(Vector *)(x + i) = z < zero ? zero : z; // NaN stays
    else {
      const Vector s = 0.5f * hyperbolic(0.5f * z) + 0.5f;
      *(Vector *)(x + i) = z * s;
      *(Vector *)(slope + i) = s * (one + z * (one - s));
    }
  }
}

// y times the slope of the activation, whose values are given.
static void steepen(int kind, float *y, const float *values, const float *slope, int64_t count) {
  for (int64_t i = 0; i < count; i++)
    y[i] *= kind == TANH   ? 1.0f - values[i] * values[i]
            : kind == RELU ? (values[i] > 0.0f ? 1.0f : 0.0f)
                           : slope[i];
}

struct Shape {
  int layers;        // of weights
  const int64_t *n;  // layers + 1 widths, hidden ones filled to a multiple of 16
  int activation;
  int64_t hidden = 0, size = 0;
  // Network k's part of a tape: values of hidden layers, of silu their slopes, too.
  template <class T> T *kept(T *tape, int64_t k, int64_t rows) const {
    return tape + k * hidden * rows * (activation == SILU ? 2 : 1);
  }
  Shape(int layers, const int64_t *n, int activation) : layers(layers), n(n), activation(activation) {
    for (int l = 0; l < layers; l++) size += n[l] * n[l + 1] + n[l + 1];
    for (int l = 1; l < layers; l++) hidden += n[l];
  }
  int64_t filled(int l) const { return (n[l] + WIDTH - 1) / WIDTH * WIDTH; }
  // Where layer l's values of `rows` rows begin, layers one behind the other.
  int64_t start(int l, int64_t rows) const {
    int64_t before = 0;
    for (int k = 1; k < l; k++) before += n[k];
    return before * rows;
  }
};

static std::vector<float> &scratch(int which, int64_t size) {
  static thread_local std::vector<float> kept[4];
  if ((int64_t)kept[which].size() < size) kept[which].resize(size);
  return kept[which];
}

// The matrix [rows][columns] with columns filled by zeros; transposed, [columns][rows] filled.
static const float *fill(int which, const float *w, int64_t rows, int64_t columns, int64_t width) {
  float *out = scratch(which, rows * width).data();
  for (int64_t i = 0; i < rows; i++) {
    memcpy(out + i * width, w + i * columns, 4 * columns);
    memset(out + i * width + columns, 0, 4 * (width - columns));
  }
  return out;
}
static const float *turn(int which, const float *w, int64_t rows, int64_t columns, int64_t width) {
  float *out = scratch(which, columns * width).data();
  for (int64_t j = 0; j < columns; j++) {
    for (int64_t i = 0; i < rows; i++) out[j * width + i] = w[i * columns + j];
    memset(out + j * width + rows, 0, 4 * (width - rows));
  }
  return out;
}

// y (+)= x w + b for some rows; y is [rows][width], width = columns filled.
static void affine(const float *x, int64_t in, const float *w, const float *b, int64_t columns,
                   int64_t width, float *y, int64_t rows, bool add) {
  if (!add)
    for (int64_t i = 0; i < rows; i++) {
      memcpy(y + i * width, b, 4 * columns);
      memset(y + i * width + columns, 0, 4 * (width - columns));
    }
  else
    for (int64_t i = 0; i < rows; i++)
      for (int64_t j = 0; j < columns; j++) y[i * width + j] += b[j];
  if (columns != width) w = fill(0, w, in, columns, width);
  product(x, in, 1, w, width, y, width, rows, width, in);
}

extern "C" {

// Has glibc hand freed blocks to the next array instead of back to the system: the page faults of
// fresh megabytes cost as much as the arithmetic that fills them.
void keep_freed_memory() {
#ifdef __GLIBC__
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, INT32_MAX);
  mallopt(M_TOP_PAD, 64 << 20);
#endif
}

// Outputs y [nets][rows][out] of networks params [nets], `stride` numbers apart, for inputs
// x [nets / share][rows][in]; tape [nets][1 or, of silu, 2][hidden * rows] gets values of hidden
// layers, and slopes.
void forward(int layers, const int64_t *n, int activation, int64_t nets, int64_t share,
             const float *params, int64_t stride, const float *x, int64_t rows, float *y,
             float *tape) {
  const Shape shape(layers, n, activation);
  const int64_t out = n[layers], width = shape.filled(layers);
  std::vector<float> last(ROWS * width);
  for (int64_t k = 0; k < nets; k++) {
    const float *p = params + k * stride, *input = x + k / share * rows * n[0];
    float *values = shape.kept(tape, k, rows), *slopes = values + shape.hidden * rows;
    for (int64_t r = 0; r < rows; r += ROWS) {
      const int64_t some = rows - r < ROWS ? rows - r : ROWS;
      const float *w = p, *from = input + r * n[0];
      for (int l = 1; l <= layers; l++) {
        const float *b = w + n[l - 1] * n[l];
        const int64_t at = shape.start(l, rows) + r * n[l];
        float *to = l < layers ? values + at : last.data();
        affine(from, n[l - 1], w, b, n[l], shape.filled(l), to, some, false);
        if (l < layers) activate(activation, to, slopes + at, some * n[l]);
        from = to, w = b + n[l];
      }
      for (int64_t i = 0; i < some; i++)
        memcpy(y + (k * rows + r + i) * out, last.data() + i * width, 4 * out);
    }
  }
}

// Products of dy [nets][rows][out] with the Jacobian: in the parameters gp [nets][gstride], numbers
// behind a network's own stay; in the inputs gx [nets][rows][in]. Either may be null.
void backward(int layers, const int64_t *n, int activation, int64_t nets, int64_t share,
              const float *params, int64_t stride, const float *x, int64_t rows, const float *tape,
              const float *dy, float *gp, int64_t gstride, float *gx) {
  const Shape shape(layers, n, activation);
  const int64_t out = n[layers], width = shape.filled(layers), in_width = shape.filled(0);
  int64_t widest = width > in_width ? width : in_width;
  for (int l = 1; l < layers; l++) widest = n[l] > widest ? n[l] : widest;
  std::vector<float> delta(ROWS * widest), before(ROWS * widest), last(n[layers - 1] * width);
  for (int64_t k = 0; k < nets; k++) {
    const float *p = params + k * stride, *input = x + k / share * rows * n[0];
    const float *values = shape.kept(tape, k, rows), *slopes = values + shape.hidden * rows;
    float *g = gp ? gp + k * gstride : nullptr;
    if (g) memset(g, 0, 4 * shape.size);
    for (int64_t r = 0; r < rows; r += ROWS) {
      const int64_t some = rows - r < ROWS ? rows - r : ROWS;
      for (int64_t i = 0; i < some; i++) {
        memcpy(&delta[i * width], dy + (k * rows + r + i) * out, 4 * out);
        memset(&delta[i * width + out], 0, 4 * (width - out));
      }
      int64_t end = shape.size;
      for (int l = layers; l >= 1; l--) {
        const int64_t in = n[l - 1], columns = n[l], filled = shape.filled(l);
        const int64_t bias = end - columns, weight = bias - in * columns;
        const int64_t at = shape.start(l - 1, rows) + r * in;
        const float *from = l > 1 ? values + at : input + r * in;
        if (g) {
          if (columns == filled)
            product(from, 1, in, delta.data(), filled, g + weight, filled, in, filled, some);
          else {
            std::memset(last.data(), 0, 4 * in * filled);
            product(from, 1, in, delta.data(), filled, last.data(), filled, in, filled, some);
            for (int64_t i = 0; i < in; i++)
              for (int64_t j = 0; j < columns; j++) g[weight + i * columns + j] += last[i * filled + j];
          }
          for (int64_t i = 0; i < some; i++)
            for (int64_t j = 0; j < columns; j++) g[bias + j] += delta[i * filled + j];
        }
        if (l == 1 && !gx) break;
        const int64_t to = shape.filled(l - 1);
        memset(before.data(), 0, 4 * some * to);
        product(delta.data(), filled, 1, turn(1, p + weight, in, columns, to), to, before.data(), to,
                some, to, columns);
        if (l > 1)
          steepen(activation, before.data(), values + at, slopes + at, some * in);
        else
          for (int64_t i = 0; i < some; i++)
            memcpy(gx + (k * rows + r + i) * in, &before[i * to], 4 * in);
        delta.swap(before);
        end = weight;
      }
    }
  }
}

// Products of the Jacobian in the parameters with v [nets][vstride]: jy [nets][rows][out].
void tangent(int layers, const int64_t *n, int activation, int64_t nets, int64_t share,
             const float *params, int64_t stride, const float *x, int64_t rows, const float *tape,
             const float *v, int64_t vstride, float *jy) {
  const Shape shape(layers, n, activation);
  const int64_t out = n[layers], width = shape.filled(layers);
  int64_t widest = width;
  for (int l = 1; l < layers; l++) widest = n[l] > widest ? n[l] : widest;
  std::vector<float> dot(ROWS * widest), next(ROWS * widest), none(widest);
  for (int64_t k = 0; k < nets; k++) {
    const float *input = x + k / share * rows * n[0];
    const float *values = shape.kept(tape, k, rows), *slopes = values + shape.hidden * rows;
    for (int64_t r = 0; r < rows; r += ROWS) {
      const int64_t some = rows - r < ROWS ? rows - r : ROWS;
      int64_t weight = 0;
      const float *from = input + r * n[0];
      for (int l = 1; l <= layers; l++) {
        const int64_t in = n[l - 1], bias = weight + in * n[l], filled = shape.filled(l);
        const float *vk = v + k * vstride, *pk = params + k * stride;
        affine(from, in, vk + weight, vk + bias, n[l], filled, next.data(), some, false);
        if (l > 1) affine(dot.data(), in, pk + weight, none.data(), n[l], filled, next.data(), some, true);
        const int64_t at = shape.start(l, rows) + r * n[l];
        if (l < layers)
          steepen(activation, next.data(), values + at, slopes + at, some * n[l]);
        from = values + at;
        dot.swap(next);
        weight = bias + n[l];
      }
      for (int64_t i = 0; i < some; i++)
        memcpy(jy + (k * rows + r + i) * out, &dot[i * width], 4 * out);
    }
  }
}

// One step of Adam down the gradient, all [runs][size], in place; rest1, rest2 [runs]: 1 - beta^t.
void adam(int64_t runs, int64_t size, float *__restrict params, const float *__restrict gradient,
          float *__restrict mean, float *__restrict square, const float *rest1, const float *rest2,
          float rate) {
  for (int64_t k = 0; k < runs; k++) {
    const float one = rest1[k], two = rest2[k];
    for (int64_t i = k * size; i < (k + 1) * size; i++) {
      const float g = gradient[i];
      mean[i] += 0.1f * (g - mean[i]);
      square[i] = 0.999f * square[i] + 0.001f * g * g;
      params[i] -= rate * (mean[i] / one) / (sqrtf(square[i] / two) + 1e-8f);
    }
  }
}
}
